//! Videos in rows, and what they have in common.

use super::{COMPARED, Difference, JudgedVideo, VideoSettings, Videos};
use crate::stats::normal::TWO_SIDED_95;
use crate::study::settings::{Study, told};
use crate::study::summary::number;
use std::collections::{BTreeMap, BTreeSet};

/// A mean error beyond so many standard deviations is too many.
const BEYOND: f64 = 3.0;

/// What the videos of a cell say of one quantity.
#[derive(Clone, Debug, PartialEq)]
pub struct Line {
    /// Number of the cell.
    pub cell: usize,
    /// Name of the quantity.
    pub quantity: &'static str,
    /// Vehicles of which it is determined.
    pub count: usize,
    /// Errors over their standard deviations, root mean square over frames and videos, and its 95 % interval.
    pub rms: [f64; 3],
    /// The same of mean errors: a mean over the frames counts once.
    pub mean_rms: f64,
    /// Mean of mean errors over their standard deviations: what all videos share.
    pub bias: f64,
    /// Share of mean errors within the 95 % interval that their standard deviations give.
    pub within_95: f64,
    /// Mean errors beyond three standard deviations, and those of them that are said to be reliable.
    pub beyond: [usize; 2],
}

/// A line for each cell and quantity.
pub fn lines(cells: &[Videos]) -> Vec<Line> {
    let of_cell = |(cell, videos): (usize, &Videos)| -> Vec<Line> {
        (0..COMPARED.len()).filter_map(|at| line(cell, videos, at)).collect()
    };
    cells.iter().enumerate().flat_map(of_cell).collect()
}

fn line(cell: usize, videos: &Videos, at: usize) -> Option<Line> {
    let quantity = COMPARED[at].0;
    // What the camera is off by is the same beside each vehicle.
    let vehicles = if quantity.starts_with("camera") { 1 } else { usize::MAX };
    let all: Vec<(&JudgedVideo, Difference)> = videos
        .iter()
        .flatten()
        .flat_map(|video| {
            let own = video.vehicles.iter().take(vehicles);
            own.map(move |(_, vehicle)| (video, vehicle.differences[at]))
        })
        .filter(|(_, difference)| difference.rms_ratio.is_finite())
        .collect();
    if all.is_empty() {
        return None;
    }
    let count = all.len() as f64;
    let mean = |of: &dyn Fn(&Difference) -> f64| all.iter().map(|(_, d)| of(d)).sum::<f64>() / count;
    let square = mean(&|d| d.rms_ratio.powi(2));
    let spread = mean(&|d| (d.rms_ratio.powi(2) - square).powi(2)).sqrt();
    let half = TWO_SIDED_95 * spread / count.sqrt();
    let beyond = || all.iter().filter(|(_, d)| d.mean_ratio.abs() > BEYOND);
    Some(Line {
        cell,
        quantity,
        count: all.len(),
        rms: [square, (square - half).max(0.0), square + half].map(f64::sqrt),
        mean_rms: mean(&|d| d.mean_ratio.powi(2)).sqrt(),
        bias: mean(&|d| d.mean_ratio),
        within_95: mean(&|d| f64::from(u8::from(d.mean_ratio.abs() <= TWO_SIDED_95))),
        beyond: [beyond().count(), beyond().filter(|(video, _)| video.is_relied_on()).count()],
    })
}

/// Header and rows of `summary.csv`.
pub fn summary_table(study: &Study, cells: &[Videos]) -> (Vec<String>, Vec<Vec<String>>) {
    let own = [
        "quantity",
        "count",
        "rms",
        "rms_low",
        "rms_high",
        "mean_rms",
        "bias",
        "within_95",
        "beyond_3",
        "beyond_3_yes",
        "videos",
        "yes",
        "without_result",
        "wrong_found",
        "right_kept",
        "shape_m",
    ];
    let header = study.columns(&own);
    let all = study.cells();
    let rows = lines(cells).into_iter().map(|line| {
        let videos = &cells[line.cell];
        let mut row = study.cell_cells(line.cell, &all[line.cell]);
        let values = [line.rms[0], line.rms[1], line.rms[2], line.mean_rms, line.bias, line.within_95];
        row.extend([line.quantity.to_owned(), line.count.to_string()]);
        row.extend(values.map(|value| number(Some((value * 1e6).round() / 1e6))));
        row.extend(line.beyond.map(|count| count.to_string()));
        let good: Vec<&JudgedVideo> = videos.iter().flatten().collect();
        let yes = good.iter().filter(|video| video.is_relied_on()).count();
        row.extend([videos.len(), yes, videos.len() - good.len()].map(|count| count.to_string()));
        let vehicles = || good.iter().flat_map(|video| &video.vehicles);
        let tracks = |at: usize| vehicles().map(|(_, vehicle)| vehicle.tracks[at]).sum::<usize>() as f64;
        let share = |part: f64, of: f64| number((of > 0.0).then(|| part / of));
        let shapes: f64 = vehicles().map(|(_, vehicle)| vehicle.shape_m.powi(2)).sum();
        row.extend([
            share(tracks(1), tracks(0)),
            share(tracks(3), tracks(2)),
            number(Some((shapes / vehicles().count().max(1) as f64).sqrt())),
        ]);
        row
    });
    let rows = rows.collect();
    (header, rows)
}

/// Header and rows of `videos.csv`: a row for each video and vehicle, with what was drawn for it.
pub fn video_table(
    study: &Study,
    settings: &VideoSettings,
    cells: &[Videos],
) -> (Vec<String>, Vec<Vec<String>>) {
    let all = study.cells();
    let of_video = |cell: usize, video: usize| -> BTreeMap<String, String> {
        let own = study.drawn(settings, &all[cell], video).into_iter();
        own.map(|(key, value)| (key, told(&value))).collect()
    };
    let of_cell = |(cell, videos): (usize, &Videos)| -> Vec<_> {
        (0..videos.len()).map(|video| of_video(cell, video)).collect()
    };
    let drawn: Vec<Vec<BTreeMap<String, String>>> = cells.iter().enumerate().map(of_cell).collect();
    let keys: BTreeSet<&String> = drawn.iter().flatten().flat_map(BTreeMap::keys).collect();
    let mut header = study.columns(&["video"]);
    header.extend(keys.iter().map(|key| (*key).clone()));
    header.extend(
        [
            "vehicle",
            "trust",
            "reasons",
            "stop",
            "iterations",
            "wrong_tracks",
            "found",
            "right_tracks",
            "kept",
            "shape_m",
        ]
        .map(str::to_owned),
    );
    for (name, _) in COMPARED {
        header.extend(["error", "sigma", "mean", "rms"].map(|what| format!("{name}_{what}")));
    }
    header.push("why_not".to_owned());
    let mut rows = Vec::new();
    for (cell, videos) in cells.iter().enumerate() {
        for (at, video) in videos.iter().enumerate() {
            let mut place = study.cell_cells(cell, &all[cell]);
            place.push(at.to_string());
            place.extend(keys.iter().map(|key| drawn[cell][at].get(*key).cloned().unwrap_or_default()));
            let begin = place.len();
            let video = match video {
                Ok(video) => video,
                Err(why) => {
                    place.resize(header.len() - 1, String::new());
                    place.push(why.clone());
                    rows.push(place);
                    continue;
                }
            };
            for (vehicle, judged) in &video.vehicles {
                let mut row = place[..begin].to_vec();
                row.push(study.scenarios[all[cell].scenario].vehicles[*vehicle].clone());
                row.extend([video.trust.clone(), video.reasons.join(" "), video.stop.clone()]);
                row.push(video.iterations.to_string());
                row.extend(judged.tracks.map(|count| count.to_string()));
                row.push(number(Some(judged.shape_m)));
                for d in &judged.differences {
                    let values = [d.mean, d.sigma, d.mean_ratio, d.rms_ratio];
                    row.extend(values.map(|value| number(value.is_finite().then_some(value))));
                }
                row.push(String::new());
                rows.push(row);
            }
        }
    }
    (header, rows)
}

#[cfg(test)]
mod tests {
    use super::super::JudgedVehicle;
    use super::*;

    #[test]
    fn a_line_counts_ratios_and_those_that_are_relied_on() {
        let video = |trust: &str, ratio: f64| {
            let d = Difference { mean: ratio, sigma: 1.0, mean_ratio: ratio, rms_ratio: ratio.abs() };
            let vehicle = JudgedVehicle { differences: [d; COMPARED.len()], shape_m: 0.0, tracks: [0; 4] };
            Ok(JudgedVideo {
                trust: trust.to_owned(),
                reasons: Vec::new(),
                stop: String::new(),
                iterations: 1,
                vehicles: vec![(0, vehicle), (1, vehicle)],
            })
        };
        let videos = vec![vec![video("yes", 4.0), video("no", -5.0), video("yes", 0.0), Err(String::new())]];
        let lines = lines(&videos);
        assert_eq!(lines.len(), COMPARED.len());
        let (x, camera) = (&lines[0], &lines[8]);
        assert_eq!((x.count, camera.count), (6, 3));
        assert_eq!((x.beyond, camera.beyond), ([4, 2], [2, 1]));
        assert!((x.rms[0] - (41.0_f64 / 3.0).sqrt()).abs() < 1e-12 && (x.bias + 1.0 / 3.0).abs() < 1e-12);
        assert!((x.within_95 - 1.0 / 3.0).abs() < 1e-12);
    }
}
