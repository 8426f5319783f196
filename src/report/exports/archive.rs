//! A result as `evo_ape --save_results` writes it and `evo_res` reads it: a ZIP archive with `info.json`,
//! `stats.json`, arrays of NumPy, and both trajectories under the names that `info.json` gives them.

use super::super::File;
use super::super::evaluation::DistancesReport;
use super::trajectories::{of_reference, of_result, tum};
use crate::evaluate::VehicleEvaluation;
use crate::evaluate::alignment::{Aligned, Alignment};
use crate::geometry::Pose;
use serde_json::json;
use std::io::{Cursor, Write};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, ZipWriter};

/// The archive of a vehicle's absolute position errors. The same comparison gives the same bytes.
pub fn evo(found: &VehicleEvaluation) -> File {
    let VehicleEvaluation { vehicle, track, .. } = found;
    let [ref_name, est_name] = ["reference", "track"].map(|of| format!("{of}_{vehicle}"));
    let info = json!({
        "title": title(&track.aligned),
        "ref_name": &ref_name,
        "est_name": &est_name,
        "label": "APE (m)",
    });
    let DistancesReport { rmse, mean, median, std, min, max, sse, .. } = track.distances_m.into();
    let stats = json!({
        "rmse": rmse, "mean": mean, "median": median, "std": std, "min": min, "max": max, "sse": sse,
    });
    let (result, reference) = (of_result(track), of_reference(track));
    let times: Vec<f64> = result.iter().map(|(time_s, _)| *time_s).collect();
    let since_first: Vec<f64> = times.iter().map(|time_s| time_s - times[0]).collect();
    let errors: Vec<f64> = track.compared.iter().map(|at| at.difference_m.norm()).collect();
    let mut files: Vec<File> = vec![
        ("info.json".to_owned(), info.to_string().into_bytes()),
        ("stats.json".to_owned(), stats.to_string().into_bytes()),
        ("error_array.npy".to_owned(), vector(&errors)),
        ("seconds_from_start.npy".to_owned(), vector(&since_first)),
        ("timestamps.npy".to_owned(), vector(&times)),
        ("distances_from_start.npy".to_owned(), vector(&travelled(&reference))),
        ("distances.npy".to_owned(), vector(&travelled(&result))),
    ];
    if track.aligned.alignment != Alignment::None {
        let matrix = npy("(4, 4)", &matrix_by_rows(&track.aligned));
        files.push(("alignment_transformation_sim3.npy".to_owned(), matrix));
    }
    files.push((format!("{ref_name}.tum"), tum(&reference)));
    files.push((format!("{est_name}.tum"), tum(&result)));
    (format!("evo_{vehicle}.zip"), stored(&files))
}

/// The title that evo gives: it warns where those of two results differ.
fn title(aligned: &Aligned) -> String {
    let how = match aligned.alignment {
        Alignment::None => "not aligned",
        Alignment::Rigid => "with SE(3) Umeyama alignment",
        Alignment::Similarity => "with Sim(3) Umeyama alignment",
    };
    format!("APE w.r.t. translation part (m)\n({how})")
}

/// Length of the way up to each place \[m\].
fn travelled(poses: &[(f64, Pose)]) -> Vec<f64> {
    let step = |pair: &[(f64, Pose)]| {
        let [from, to] = [0, 1].map(|at| pair[at].1.translation.vector);
        (to - from).norm()
    };
    let mut way = vec![0.0];
    for step in poses.windows(2).map(step) {
        way.push(way[way.len() - 1] + step);
    }
    way
}

/// `reference = scale R result + t` as one matrix.
fn matrix_by_rows(aligned: &Aligned) -> Vec<f64> {
    let mut matrix = aligned.motion.to_homogeneous();
    matrix.fixed_view_mut::<3, 3>(0, 0).scale_mut(aligned.scale);
    matrix.transpose().iter().copied().collect()
}

fn vector(values: &[f64]) -> Vec<u8> {
    npy(&format!("({},)", values.len()), values)
}

/// An array as NumPy stores it, version 1.0: 64 bits, little endian. The header fills up to a multiple of 64.
fn npy(shape: &str, values: &[f64]) -> Vec<u8> {
    let about = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}");
    let before = b"\x93NUMPY\x01\x00";
    let length = (before.len() + 2 + about.len() + 1).next_multiple_of(64) - before.len() - 2;
    let mut bytes = before.to_vec();
    bytes.extend(u16::try_from(length).expect("a short header").to_le_bytes());
    bytes.extend(format!("{about:<width$}\n", width = length - 1).into_bytes());
    values.iter().for_each(|value| bytes.extend(value.to_le_bytes()));
    bytes
}

/// An archive of files, not compressed, all from the first day that such an archive knows.
fn stored(files: &[File]) -> Vec<u8> {
    let options = SimpleFileOptions::default()
        .compression_method(CompressionMethod::Stored)
        .last_modified_time(DateTime::default())
        .unix_permissions(0o644);
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, bytes) in files {
        archive.start_file(name, options).expect("writing to memory");
        archive.write_all(bytes).expect("writing to memory");
    }
    archive.finish().expect("writing to memory").into_inner()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::pose;

    #[test]
    fn arrays_are_those_of_numpy() {
        // numpy.save of numpy.array([1.5, -2.0]), NumPy 2.4.
        let mut wanted =
            b"\x93NUMPY\x01\x00v\x00{'descr': '<f8', 'fortran_order': False, 'shape': (2,), }".to_vec();
        wanted.resize(127, b' ');
        wanted.push(b'\n');
        wanted.extend([0, 0, 0, 0, 0, 0, 0xf8, 0x3f, 0, 0, 0, 0, 0, 0, 0, 0xc0]);
        assert_eq!(vector(&[1.5, -2.0]), wanted);
        for count in [0, 9, 10, 1_000_000_000] {
            assert_eq!(npy(&format!("({count},)"), &[]).len(), 128);
        }
    }

    #[test]
    fn an_alignment_is_one_matrix_by_rows() {
        // A quarter turn about z: x goes to y.
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let motion = pose([1.0, 2.0, 3.0], [half, 0.0, 0.0, half]);
        let aligned = Aligned { alignment: Alignment::Similarity, scale: 2.0, motion, ..Aligned::none() };
        let wanted = [0.0, -2.0, 0.0, 1.0, 2.0, 0.0, 0.0, 2.0, 0.0, 0.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0];
        let found = matrix_by_rows(&aligned);
        assert!(
            found.len() == 16 && found.iter().zip(wanted).all(|(a, b)| (a - b).abs() < 1e-15),
            "{found:?}"
        );
    }

    #[test]
    fn a_way_is_the_sum_of_its_steps() {
        let at = |x: f64, y: f64| (0.0, pose([x, y, 0.0], [1.0, 0.0, 0.0, 0.0]));
        assert_eq!(
            travelled(&[at(0.0, 0.0), at(3.0, 4.0), at(3.0, 4.0), at(3.0, 3.0)]),
            [0.0, 5.0, 5.0, 6.0]
        );
        assert_eq!(travelled(&[at(7.0, 0.0)]), [0.0]);
    }
}
