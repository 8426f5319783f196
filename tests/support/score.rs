//! An estimate held against the truth of a simulated problem.

use nalgebra::Point3;
use std::collections::BTreeMap;
use std::path::Path;
use trackbundle::geometry::align::rigid_fit_trimmed;

/// The numbers of the seed paper's kind. Shape errors after a rigid fit on the best 80 % of the
/// points, marker errors without any fit.
#[derive(Clone, Copy, Debug)]
pub struct Score {
    pub points: usize,
    pub shape_median_m: f64,
    pub shape_p95_m: f64,
    pub share_within_5cm: f64,
    pub marker_rms_xy_m: f64,
    pub marker_mad_x_m: f64,
    pub marker_mad_y_m: f64,
    pub marker_rms_z_m: f64,
    pub speed_mad_mps: f64,
    pub heading_p95_deg: f64,
    pub scale: f64,
}

/// Scores a result folder of `vehicle` against `truth`.
pub fn score(result: &Path, truth: &Path, vehicle: &str) -> Score {
    let of_vehicle = |rows: Vec<BTreeMap<String, String>>| -> Vec<BTreeMap<String, String>> {
        rows.into_iter().filter(|r| r.get("vehicle").is_none_or(|v| v == vehicle)).collect()
    };
    let points = |folder: &Path| -> BTreeMap<String, Point3<f64>> {
        let rows = of_vehicle(rows(&folder.join("vehicle_points.csv")));
        rows.iter().filter_map(|r| Some((r["point"].clone(), xyz(r)?))).collect()
    };
    let (found, true_points) = (points(result), points(truth));
    let pairs: Vec<(Point3<f64>, Point3<f64>)> =
        found.iter().filter_map(|(id, p)| Some((*p, *true_points.get(id)?))).collect();
    let (from, to): (Vec<_>, Vec<_>) = pairs.into_iter().unzip();
    let fit = rigid_fit_trimmed(&from, &to, 0.8).expect("a shape");
    let shape: Vec<f64> = from.iter().zip(&to).map(|(a, b)| (fit * a - b).norm()).collect();
    let size = |points: &[Point3<f64>]| {
        let mean = points.iter().map(|p| p.coords).sum::<nalgebra::Vector3<f64>>() / points.len() as f64;
        median(points.iter().map(|p| (p.coords - mean).norm()).collect())
    };

    let track: BTreeMap<String, BTreeMap<String, String>> =
        of_vehicle(rows(&result.join("trajectories.csv")))
            .into_iter()
            .map(|r| (r["frame"].clone(), r))
            .collect();
    let poses: BTreeMap<String, BTreeMap<String, String>> =
        of_vehicle(rows(&truth.join("vehicle_poses.csv")))
            .into_iter()
            .map(|r| (r["frame"].clone(), r))
            .collect();
    let (mut dx, mut dy, mut dz, mut dv, mut dh) = (vec![], vec![], vec![], vec![], vec![]);
    for row in rows(&truth.join(format!("trajectory_{vehicle}.csv"))) {
        let Some(at) = track.get(&row["frame"]) else { continue };
        let (found, truth) = (xyz(at).unwrap(), xyz(&row).unwrap());
        dx.push(found.x - truth.x);
        dy.push(found.y - truth.y);
        dz.push(found.z - truth.z);
        dv.push(
            number(at, "speed_mps").unwrap() - number(&row, "vx").unwrap().hypot(number(&row, "vy").unwrap()),
        );
        let pose = &poses[&row["frame"]];
        let q = |name| number(pose, name).unwrap();
        let pose = trackbundle::geometry::pose([0.0; 3], [q("qw"), q("qx"), q("qy"), q("qz")]);
        let turn =
            number(at, "heading_deg").unwrap() - trackbundle::geometry::heading_rad(&pose).to_degrees();
        dh.push((turn + 540.0).rem_euclid(360.0) - 180.0);
    }
    let rms = |a: &[f64]| (a.iter().map(|v| v * v).sum::<f64>() / a.len() as f64).sqrt();
    Score {
        points: shape.len(),
        shape_p95_m: percentile(shape.clone(), 0.95),
        share_within_5cm: shape.iter().filter(|d| **d <= 0.05).count() as f64 / shape.len() as f64,
        shape_median_m: median(shape),
        marker_rms_xy_m: rms(&dx).hypot(rms(&dy)),
        marker_rms_z_m: rms(&dz),
        marker_mad_x_m: mad(dx),
        marker_mad_y_m: mad(dy),
        speed_mad_mps: mad(dv),
        heading_p95_deg: percentile(dh.iter().map(|v| v.abs()).collect(), 0.95),
        scale: size(&from) / size(&to),
    }
}

/// The rows of a CSV file by column name.
pub fn rows(path: &Path) -> Vec<BTreeMap<String, String>> {
    let mut reader = csv::Reader::from_path(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    reader.deserialize().map(|row| row.unwrap()).collect()
}

fn number(row: &BTreeMap<String, String>, column: &str) -> Option<f64> {
    row[column].parse().ok()
}

fn xyz(row: &BTreeMap<String, String>) -> Option<Point3<f64>> {
    Some(Point3::new(number(row, "x")?, number(row, "y")?, number(row, "z")?))
}

pub fn median(values: Vec<f64>) -> f64 {
    percentile(values, 0.5)
}

fn percentile(mut values: Vec<f64>, share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    values[((values.len() - 1) as f64 * share).round() as usize]
}

/// Median absolute deviation from the median.
fn mad(values: Vec<f64>) -> f64 {
    let middle = median(values.clone());
    median(values.into_iter().map(|v| (v - middle).abs()).collect())
}

/// Points shifted in x and y and turned about z onto the true ones: the part of the frame that neither terrain
/// nor a known height holds.
pub fn laid_on_truth(
    found: &[Option<nalgebra::Point3<f64>>],
    truth: &[nalgebra::Point3<f64>],
) -> Vec<Option<nalgebra::Vector3<f64>>> {
    use nalgebra::Vector3;
    let pairs = || found.iter().zip(truth).filter_map(|(p, q)| Some(((*p)?.coords, q.coords)));
    let count = pairs().count() as f64;
    let (from, to) =
        pairs().fold((Vector3::zeros(), Vector3::zeros()), |(a, b), (p, q)| (a + p / count, b + q / count));
    let (mut dot, mut cross) = (0.0, 0.0);
    for (p, q) in pairs() {
        let (p, q) = ((p - from).xy(), (q - to).xy());
        dot += p.dot(&q);
        cross += p.perp(&q);
    }
    let turn = trackbundle::geometry::rotation::exp(&(Vector3::z() * cross.atan2(dot)));
    let shift = Vector3::new(to.x, to.y, from.z);
    found.iter().map(|p| Some(turn * ((*p)?.coords - from) + shift)).collect()
}
