//! The facts of a result, each made once from its data: for a terminal, for a document, for a page.

use super::format::{counted, decimal_or_dash, grouped, plain, whole_or_dash};
use super::verdict_lines;
use crate::diagnose::Verdict;
use crate::refine::{RejectionReason, Tally};

/// Where a fact is read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Style {
    /// In plain letters.
    Terminal,
    /// With a true minus and dashes.
    Page,
}

impl Style {
    fn number(self, value: Option<f64>, digits: usize) -> String {
        match self {
            Style::Terminal => plain(value, digits),
            Style::Page => decimal_or_dash(value, digits),
        }
    }
}

/// What was adjusted and how well it fits; `None` and an empty text are what is not known.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ResultFacts<'a> {
    /// `converged` and the like.
    pub status: &'a str,
    /// Why the last round stopped.
    pub stop: &'a str,
    /// Iterations of all rounds.
    pub iterations: Option<usize>,
    /// Cost at the start and at the end.
    pub cost: [Option<f64>; 2],
    /// Rows.
    pub rows: Option<usize>,
    /// Numbers that were adjusted.
    pub parameters: Option<usize>,
    /// Rows minus parameters.
    pub redundancy: Option<i64>,
    /// Standard deviation of unit weight a posteriori.
    pub sigma0: Option<f64>,
    /// Root mean square of image residuals \[px\]: of all, of vehicles, of targets.
    pub rms_px: [Option<f64>; 3],
    /// Gross errors.
    pub gross: Option<usize>,
    /// Image points that were given, and that were used.
    pub image_points: [Option<usize>; 2],
    /// Name and scale of the robust loss.
    pub loss: (&'a str, Option<f64>),
    /// The motion priors.
    pub motion: Vec<MotionFacts<'a>>,
    /// Check points: their ids, and differences \[m\].
    pub check_points: Vec<(&'a str, [Option<f64>; 3])>,
}

/// A motion prior.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionFacts<'a> {
    /// Of what.
    pub body: &'a str,
    /// `acceleration` or `jerk`.
    pub white_noise: &'a str,
    /// Strength of the position and of the attitude.
    pub strength: [Option<f64>; 2],
    /// Whether it was estimated.
    pub is_estimated: bool,
}

impl MotionFacts<'_> {
    /// The power of the second in the unit of the strength.
    fn power(&self) -> u32 {
        if self.white_noise == "jerk" { 3 } else { 2 }
    }

    fn strengths(&self, style: Style) -> [String; 2] {
        self.strength.map(|value| style.number(value, 3))
    }

    fn told_estimated(&self) -> &'static str {
        if self.is_estimated { " (estimated)" } else { "" }
    }
}

impl ResultFacts<'_> {
    fn rms(&self, style: Style) -> String {
        let [all, vehicles, targets] = self.rms_px.map(|rms_px| style.number(rms_px, 2));
        format!("{all} px (vehicles {vehicles}, targets {targets})")
    }

    /// The result in a few lines for a terminal.
    pub fn summary(&self, tally: &Tally, verdict: &Verdict) -> String {
        let grouped = |count: usize| grouped(count, ',');
        let mut text = format!(
            "adjusted    {} after {} ({})\n",
            self.status.replace('_', " "),
            counted(self.iterations.unwrap_or(0), "iteration"),
            self.stop
        );
        let [start, end] = self.cost.map(|cost| cost.map_or("-".to_owned(), |cost| format!("{cost:.6e}")));
        text += &format!("cost        {start} to {end}\n");
        text += &format!(
            "sigma0      {} from {} and {}, redundancy {}\n",
            plain(self.sigma0, 4),
            counted(self.rows.unwrap_or(0), "row"),
            counted(self.parameters.unwrap_or(0), "parameter"),
            super::format::grouped(self.redundancy.unwrap_or(0), ',')
        );
        let gross = counted(self.gross.unwrap_or(0), "gross error");
        text += &format!("residuals   rms {}, {gross}\n", self.rms(Style::Terminal));
        if tally.gross() > 0 {
            text += &format!(
                "rejected    {} by itself, {} with the track, {} with the frame; {} of {} used, {} of these with less than half the weight\n",
                grouped(tally.of(RejectionReason::ImagePoint)),
                with_track(tally),
                grouped(tally.of(RejectionReason::Frame)),
                grouped(tally.used + tally.down_weighted),
                counted(tally.all(), "image point"),
                grouped(tally.down_weighted)
            );
        }
        for motion in &self.motion {
            let [linear, angular] = motion.strengths(Style::Terminal);
            let (power, estimated) = (motion.power(), motion.told_estimated());
            text += &format!(
                "motion      of {}: {} {linear} m/s^{power}, {angular} deg/s^{power} over one second{estimated}\n",
                motion.body, motion.white_noise
            );
        }
        for (target, difference_m) in &self.check_points {
            let [x, y, z] = difference_m.map(|value| plain(value, 3));
            text += &format!("check       {target}: {x} {y} {z} m\n");
        }
        for (word, line) in verdict_lines(verdict) {
            text += &format!("{word:12}{line}\n");
        }
        text
    }

    /// The same in two lines of Markdown; nothing where it is not known how it was adjusted.
    pub fn document_lines(&self) -> String {
        let Some(iterations) = self.iterations else { return String::new() };
        let count = |value: Option<usize>| value.map_or("-".to_owned(), |value| value.to_string());
        format!(
            "- **adjusted** {} after {iterations} iterations ({})\n- **residuals** rms {} px; gross errors {} of {}\n",
            or_sign(self.status, "-"),
            or_sign(self.stop, "-"),
            plain(self.rms_px[0], 3),
            count(self.gross),
            count(self.image_points[0])
        )
    }

    /// The same as rows of a table on a page: a name and what it is.
    pub fn page_rows(&self) -> Vec<(String, String)> {
        let dash = super::format::DASH;
        let listed = |all: &[String]| all.join(", ");
        let (loss, scale) = self.loss;
        let mut rows: Vec<(String, String)> = [
            ("status", format!("{} ({})", or_sign(self.status, dash), or_sign(self.stop, dash))),
            ("iterations, all rounds", whole_or_dash(self.iterations)),
            ("cost at the start, at the end", listed(&self.cost.map(|cost| decimal_or_dash(cost, 1)))),
            (
                "rows, parameters, redundancy",
                listed(&[
                    whole_or_dash(self.rows),
                    whole_or_dash(self.parameters),
                    whole_or_dash(self.redundancy),
                ]),
            ),
            ("sigma0 a posteriori (a priori 1)", decimal_or_dash(self.sigma0, 4)),
            ("image residuals, rms", self.rms(Style::Page)),
            (
                "image points given, used, gross errors",
                listed(&[self.image_points[0], self.image_points[1], self.gross].map(whole_or_dash)),
            ),
            ("robust loss", format!("{}, scale {} sigma", or_sign(loss, dash), decimal_or_dash(scale, 2))),
        ]
        .map(|(name, value)| (name.to_owned(), value))
        .into();
        rows.extend(self.motion.iter().map(|motion| {
            let [linear, angular] = motion.strengths(Style::Page);
            let (power, estimated) = (motion.power(), motion.told_estimated());
            let white = or_sign(motion.white_noise, dash);
            (
                format!("motion of {}", or_sign(motion.body, dash)),
                format!("white {white}, {linear} m/s^{power} and {angular} deg/s^{power} over one second{estimated}"),
            )
        }));
        rows
    }
}

/// How many image points were rejected with their tracks, and what these are of where that is known.
fn with_track(tally: &Tally) -> String {
    let kinds = [
        RejectionReason::Static,
        RejectionReason::Sliding,
        RejectionReason::Swapped,
        RejectionReason::Foreign,
    ];
    let told = |reason: &RejectionReason| format!("{} {}", grouped(tally.of(*reason), ','), reason.name());
    let known: Vec<String> = kinds.iter().filter(|reason| tally.of(**reason) > 0).map(told).collect();
    let all = grouped(tally.with_track(), ',');
    if known.is_empty() { all } else { format!("{all} ({})", known.join(", ")) }
}

/// A text, or a sign where there is none.
fn or_sign<'a>(text: &'a str, sign: &'a str) -> &'a str {
    if text.is_empty() { sign } else { text }
}
