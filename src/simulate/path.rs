//! Where a vehicle drives: place and heading in the plan, at any time.

use super::scenario::{PathSettings, Segment, VehicleSettings};
use super::wander::{Curve, Times, hermite};
use crate::tables::{self, Finding, Findings, input_row};
use nalgebra::Vector2;
use std::path::Path;

/// Steps of integration a frame.
pub const FINE: usize = 8;
/// Below this speed a vehicle follows its plan the more closely the slower it is \[m/s\].
const SLOW_MPS: f64 = 2.0;
/// Below this speed the direction of travel says nothing \[m/s\].
const STANDS_MPS: f64 = 0.3;

/// A path in the plan.
pub enum PlanPath {
    /// Place and heading.
    Curves([Curve; 3]),
    /// The rows of a file, moved.
    Rows { rows: Vec<Fix>, shift: Vector2<f64>, turn_rad: f64 },
}

/// A place of a path from a file.
#[derive(Clone, Copy, Debug)]
pub struct Fix {
    time_s: f64,
    /// x, y and heading, and their slopes.
    nodes: [[f64; 2]; 3],
}

input_row!(
    /// A row of a path.
    PathRow {
        required time_s: f64, required x: f64, required y: f64,
        optional heading_deg: Option<f64>,
    }
);

/// Reads the rows of a path; `time_s` of the first is that of the first frame.
pub fn read_rows(folder: &Path, file: &str) -> Result<Vec<Fix>, Findings> {
    let mut findings = Findings::default();
    let rows = tables::read::<PathRow>(folder, file, &mut findings).unwrap_or_default();
    for pair in rows.windows(2) {
        if pair[1].row.time_s <= pair[0].row.time_s {
            let wanted = "a time after that of the row before";
            let found = pair[1].row.time_s.to_string();
            findings.error(Finding::of_cell(file, pair[1].line, "time_s", wanted, &found));
        }
    }
    if rows.len() < 2 && !findings.is_invalid() {
        findings.error(Finding::of_file(file, "two rows or more", &format!("{}", rows.len())));
    }
    if findings.is_invalid() {
        return Err(findings);
    }
    let begin_s = rows[0].row.time_s;
    let has_heading = rows.iter().all(|line| line.row.heading_deg.is_some());
    let slope = |of: &dyn Fn(usize) -> f64, at: usize| {
        let (before, after) = (at.saturating_sub(1), (at + 1).min(rows.len() - 1));
        (of(after) - of(before)) / (rows[after].row.time_s - rows[before].row.time_s)
    };
    let x = |at: usize| rows[at].row.x;
    let y = |at: usize| rows[at].row.y;
    let speeds: Vec<Vector2<f64>> =
        (0..rows.len()).map(|at| Vector2::new(slope(&x, at), slope(&y, at))).collect();
    let mut headings: Vec<f64> = Vec::new();
    let first = speeds.iter().find(|v| v.norm() >= STANDS_MPS).map_or(0.0, |v| v.y.atan2(v.x));
    for (line, speed) in rows.iter().zip(&speeds) {
        let last = headings.last().copied().unwrap_or(first);
        let raw = match line.row.heading_deg.filter(|_| has_heading) {
            Some(heading_deg) => heading_deg.to_radians(),
            None if speed.norm() >= STANDS_MPS => speed.y.atan2(speed.x),
            None => last,
        };
        // Without jumps.
        headings.push(last + (raw - last).sin().atan2((raw - last).cos()));
    }
    let heading = |at: usize| headings[at];
    let fix = |at: usize| Fix {
        time_s: rows[at].row.time_s - begin_s,
        nodes: [[x(at), speeds[at].x], [y(at), speeds[at].y], [headings[at], slope(&heading, at)]],
    };
    Ok((0..rows.len()).map(fix).collect())
}

/// Speed and curvature of a plan at a time, each changing evenly over a segment.
fn plan(speed_mps: f64, curvature_per_m: f64, segments: &[Segment], time_s: f64) -> [f64; 2] {
    let mut now = [speed_mps, curvature_per_m];
    let mut left = time_s.max(0.0);
    for segment in segments {
        let then = [segment.speed_mps, segment.curvature_per_m];
        if left < segment.duration_s {
            let u = left / segment.duration_s;
            return [0, 1].map(|k| now[k] + u * (then[k] - now[k]));
        }
        left -= segment.duration_s;
        now = then;
    }
    now
}

impl PlanPath {
    /// The path of a vehicle, which wanders by `along` \[m\] and `yaw` \[rad\] about its plan. `rows` are those
    /// of its file; they do not wander.
    pub fn new(
        vehicle: &VehicleSettings,
        rows: &[Fix],
        times: Times,
        [along, yaw]: [&Curve; 2],
        middle_s: f64,
    ) -> Self {
        let turn_rad = vehicle.heading_deg.to_radians();
        let shift = Vector2::new(vehicle.x_m, vehicle.y_m);
        let PathSettings::Driven { speed_mps, curvature_per_m, segments } = &vehicle.path else {
            return PlanPath::Rows { rows: rows.to_vec(), shift, turn_rad };
        };
        // Speed and yaw rate.
        let rates = |time_s: f64| {
            let [speed, curvature] = plan(*speed_mps, *curvature_per_m, segments, time_s);
            let part = (speed / SLOW_MPS).min(1.0);
            [speed + part * along.at(time_s)[1], speed * curvature + part * yaw.at(time_s)[1]]
        };
        let h = times.step_s;
        let mut state = [0.0_f64; 3];
        let mut nodes: Vec<[[f64; 2]; 3]> = Vec::with_capacity(times.count);
        for at in 0..times.count {
            let t = times.time(at);
            let [v, r] = rates(t);
            let (sin, cos) = state[2].sin_cos();
            nodes.push([[state[0], v * cos], [state[1], v * sin], [state[2], r]]);
            // Simpson's rule, the heading in the middle and at the end from its own.
            let ([vm, rm], [ve, re]) = (rates(t + 0.5 * h), rates(t + h));
            let middle = state[2] + h * (5.0 * r + 8.0 * rm - re) / 24.0;
            let end = state[2] + h * (r + 4.0 * rm + re) / 6.0;
            state[0] += h * (v * cos + 4.0 * vm * middle.cos() + ve * end.cos()) / 6.0;
            state[1] += h * (v * sin + 4.0 * vm * middle.sin() + ve * end.sin()) / 6.0;
            state[2] = end;
        }
        let curves = |nodes: &[[[f64; 2]; 3]]| {
            [0, 1, 2].map(|k| Curve::new(times, nodes.iter().map(|node| node[k]).collect()))
        };
        // To where it is to be in the middle of the video.
        let [x, y, heading] = curves(&nodes).map(|curve| curve.at(middle_s)[0]);
        let turn = turn_rad - heading;
        let (sin, cos) = turn.sin_cos();
        let rotate = |x: f64, y: f64| [cos * x - sin * y, sin * x + cos * y];
        for [px, py, ph] in &mut nodes {
            let place = rotate(px[0] - x, py[0] - y);
            let speed = rotate(px[1], py[1]);
            *px = [place[0] + shift.x, speed[0]];
            *py = [place[1] + shift.y, speed[1]];
            ph[0] += turn;
        }
        PlanPath::Curves(curves(&nodes))
    }

    /// x, y \[m\] and heading \[rad\], with their slopes.
    pub fn at(&self, time_s: f64) -> [[f64; 2]; 3] {
        match self {
            PlanPath::Curves(curves) => [0, 1, 2].map(|k| curves[k].at(time_s)),
            PlanPath::Rows { rows, shift, turn_rad } => {
                let at = rows.partition_point(|row| row.time_s <= time_s).clamp(1, rows.len() - 1);
                let (a, b) = (&rows[at - 1], &rows[at]);
                let step = b.time_s - a.time_s;
                // Beyond the first and the last by no more than a frame.
                let u = (time_s - a.time_s) / step;
                let [x, y, h] = [0, 1, 2].map(|k| hermite(a.nodes[k], b.nodes[k], step, u));
                let (sin, cos) = turn_rad.sin_cos();
                [
                    [cos * x[0] - sin * y[0] + shift.x, cos * x[1] - sin * y[1]],
                    [sin * x[0] + cos * y[0] + shift.y, sin * x[1] + cos * y[1]],
                    [h[0] + turn_rad, h[1]],
                ]
            }
        }
    }

    /// Until when it is known \[s\].
    pub fn end_s(rows: &[Fix]) -> f64 {
        rows.last().map_or(f64::INFINITY, |fix| fix.time_s)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulate::scenario::BodySettings;
    use crate::simulate::wander::{Purpose, stream, wander};

    fn vehicle(path: PathSettings) -> VehicleSettings {
        VehicleSettings {
            id: "car".to_owned(),
            is_car: true,
            x_m: 3.0,
            y_m: -2.0,
            heading_deg: 30.0,
            path,
            wander_m: 0.0,
            side_wander_m: 0.0,
            yaw_wander_deg: 0.0,
            wander_s: 4.0,
            pitch_by_acceleration: 0.0,
            roll_by_acceleration: 0.0,
            body: BodySettings::Car { size_m: [4.5, 1.8, 1.5] },
            points: 10,
            track_s: None,
            dropout: 0.0,
            grazing_deg: 80.0,
            rear_axle_m: 0.0,
            knowledge: Default::default(),
        }
    }

    const STOP: [Segment; 3] = [
        Segment { duration_s: 1.0, speed_mps: 8.0, curvature_per_m: 0.05 },
        Segment { duration_s: 2.0, speed_mps: 0.0, curvature_per_m: 0.05 },
        Segment { duration_s: 1.0, speed_mps: 0.0, curvature_per_m: 0.0 },
    ];

    #[test]
    fn a_plan_is_driven_as_it_says() {
        let (times, frames) = (Times::of_video(150, 30.0, FINE), Times::of_video(150, 30.0, 1));
        let path = PathSettings::Driven { speed_mps: 8.0, curvature_per_m: 0.0, segments: STOP.to_vec() };
        for sigma in [0.0, 1.0] {
            let [along, yaw] = [0, 1].map(|k| {
                wander(&mut stream(5, 0, Purpose::VehiclePath, k), sigma * [0.3, 0.02][k], 3.0, frames)
            });
            let path = PlanPath::new(&vehicle(path.clone()), &[], times, [&along, &yaw], 2.5);
            let [x, y, heading] = path.at(2.5);
            assert!((x[0] - 3.0).abs() < 1e-9 && (y[0] + 2.0).abs() < 1e-9);
            assert!((heading[0] - 30_f64.to_radians()).abs() < 1e-9);
            let h = 1e-4;
            for k in 1..49 {
                let t = 0.1 * f64::from(k);
                let [[_, vx], [_, vy], [psi, rate]] = path.at(t);
                // It never slips, whatever it wanders.
                assert!((vy * psi.cos() - vx * psi.sin()).abs() < 1e-4, "{t}");
                for (of, slope) in [(0, vx), (1, vy), (2, rate)] {
                    let difference = (path.at(t + h)[of][0] - path.at(t - h)[of][0]) / (2.0 * h);
                    assert!((difference - slope).abs() < 1e-3, "{t} {of}");
                }
                let [speed, curvature] = plan(8.0, 0.0, &STOP, t);
                if sigma == 0.0 {
                    assert!((vx.hypot(vy) - speed).abs() < 1e-6 && (rate - speed * curvature).abs() < 1e-6);
                }
                if t > 3.1 {
                    assert!(vx.hypot(vy) < 1e-9, "it stands");
                }
            }
        }
    }

    #[test]
    fn a_path_from_a_file_passes_its_rows_and_is_smooth() {
        let folder = tempfile::tempdir().unwrap();
        let file = "path.csv".to_owned();
        let place = |t: f64| (20.0 * (0.3 * t).sin(), 20.0 * (1.0 - (0.3 * t).cos()));
        let rows = (0..30).map(|k| {
            let t = 0.2 * f64::from(k);
            let (x, y) = place(t);
            format!("{},{x},{y}\n", t + 100.0)
        });
        let text = format!("time_s,x,y\n{}", rows.collect::<String>());
        std::fs::write(folder.path().join(&file), text).unwrap();
        let rows = read_rows(folder.path(), &file).unwrap();
        assert!((PlanPath::end_s(&rows) - 5.8).abs() < 1e-9);
        let mut settings = vehicle(PathSettings::File(file));
        (settings.x_m, settings.y_m, settings.heading_deg) = (0.0, 0.0, 0.0);
        let times = Times::of_video(10, 30.0, FINE);
        let still = wander(&mut stream(0, 0, Purpose::VehiclePath, 0), 0.0, 1.0, times);
        let path = PlanPath::new(&settings, &rows, times, [&still, &still], 0.0);
        for k in 5..50 {
            let t = 0.1 * f64::from(k);
            let [x, y, heading] = path.at(t);
            let wanted = place(t);
            assert!((x[0] - wanted.0).abs() < 5e-3 && (y[0] - wanted.1).abs() < 5e-3, "{t}");
            assert!((heading[0] - 0.3 * t).abs() < 5e-3, "{t}: {}", heading[0]);
            assert!((x[1].hypot(y[1]) - 6.0).abs() < 0.05);
        }
    }
}
