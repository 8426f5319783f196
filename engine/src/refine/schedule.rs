//! When the rounds of the adjustment end, and how many there are.

use crate::rules::rules;

rules! {
    /// Rounds of the adjustment: how far each goes, and how often there is another one. "Decrease" is the share
    /// of the cost by which a step must lower it, or the round ends.
    pub struct RoundSchedule {
        /// The decrease of the approach.
        approach_decrease: f64 = 1e-3, "share of the cost";
        /// After an approach with more records than this, another is tried from poses found in the images.
        long_approach: usize = 6, "records";
        /// Where tracks bend the motion to themselves, the approach begins anew without them, so often at the most.
        most_new_approaches: usize = 2, "rounds";
        /// The most iterations of a round before the last.
        interim_iterations: usize = 10, "iterations";
        /// The decrease of a graduated round, and of one between two estimates of the motion priors.
        interim_decrease: f64 = 1e-2, "share of the cost";
        /// Where a larger share of image points is gross after the approach, the loss is tightened step by step ...
        graduated_above_share: f64 = 0.1, "share of image points";
        /// ... by these factors of its scale.
        graduated_scales: [f64; 2] = [2.0, 1.0], "factor";
        /// Rounds in which motion priors are estimated, at the most.
        most_motion_rounds: usize = 8, "rounds";
        /// Motion strengths have settled when none changes by more.
        motion_settled_factor: f64 = 1.15, "factor";
        /// ... and once more after the last round, so often at the most.
        most_final_motion_rounds: usize = 6, "rounds";
        /// The decrease of the last round.
        final_decrease: f64 = 1e-8, "share of the cost";
        /// A body may be at the wrong one of two depths, which is looked for after so many iterations of the last
        /// round, if it has not ended before: in a wrong minimum it may go on for long.
        iterations_before_reversal: usize = 25, "iterations";
        /// After the last round whole tracks and frames are judged anew, and the round goes on, so often at the
        /// most.
        most_final_judgements: usize = 3, "judgements";
        /// The most iterations of the final least squares: conventions no longer hold what is weak, which may be far off.
        least_squares_iterations: usize = 100, "iterations";
        /// The decrease of the final least squares, which starts where the robust adjustment ended. Of a cost of
        /// 1e5 it leaves less than a tenth of a standard deviation in the worst direction.
        least_squares_decrease: f64 = 5e-8, "share of the cost";
        /// A point whose depth was open is let go where it is told better than by so many half sizes of a car.
        most_open_size: f64 = 0.5, "half sizes";
        /// Where conventions may pull by more than this, they are put where things are by then ...
        least_pull: f64 = 0.05, "sigma";
        /// ... as long as each time makes it less by this ...
        settling_share: f64 = 0.9, "share";
        /// ... and so often at the most.
        most_lettings_go: usize = 20, "rounds";
        /// Image points of other standard deviations than stated, by more than this, weigh what they prove to be
        /// worth ...
        reweighted_factor: f64 = 1.1, "factor";
        /// ... unless it is beyond these: data without noise prove nothing.
        reweighted_within: [f64; 2] = [0.2, 100.0], "factor";
        /// Rows of image points from which that can be said.
        reweighted_least_rows: usize = 200, "rows";
        /// Image points are weighed anew so many times at the most ...
        most_reweightings: usize = 5, "rounds";
        /// ... and no more where none changes by more.
        reweighting_settled_factor: f64 = 1.01, "factor";
    }
}
