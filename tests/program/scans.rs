//! Scans of vehicles through the program: what `check` says of them, and that damaged ones are refused.

use crate::support;

use predicates::prelude::*;
use std::path::Path;
use support::drive::Drive;
use support::program;

/// A problem with these files in `reference`.
fn problem(folder: &Path, references: &[(&str, &[u8])]) {
    Drive { frames: 6, points: 6, targets: 5, ..Default::default() }.write(folder);
    std::fs::create_dir(folder.join("reference")).unwrap();
    for (name, bytes) in references {
        std::fs::write(folder.join("reference").join(name), bytes).unwrap();
    }
}

const MESH: &[u8] = b"ply\nformat ascii 1.0\nelement vertex 4\nproperty double x\nproperty double y\n\
    property double z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n\
    0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n";

#[test]
fn check_counts_points_and_triangles() {
    for (name, bytes, says) in [
        ("car0.PLY", MESH, "scan of car0 (4 points, 2 triangles)"),
        ("car0.xyz", b"x y z\n1 2 3\n4 5 6\n", "scan of car0 (2 points)"),
    ] {
        let place = tempfile::tempdir().unwrap();
        problem(place.path(), &[(name, bytes)]);
        let said = program().arg("check").arg(place.path()).assert().success();
        said.stdout(predicate::str::contains(says)).stderr(predicate::str::contains("not read").not());
    }
}

#[test]
fn missing_points_are_counted_in_a_warning() {
    let place = tempfile::tempdir().unwrap();
    let cloud =
        b"VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 3\nHEIGHT 1\nPOINTS 3\nDATA ascii\n\
        1 2 3\nnan nan nan\n4 5 6\n";
    problem(place.path(), &[("car0.pcd", cloud)]);
    let warning = "reference/car0.pcd: 1 of 3 points have no coordinates";
    let said = program().arg("check").arg(place.path()).assert().success();
    said.stderr(predicate::str::contains(warning)).stdout(predicate::str::contains("car0 (2 points)"));
}

#[test]
fn damaged_scans_are_refused_by_name() {
    for (name, bytes, found) in [
        ("car0.ply", &MESH[..MESH.len() - 3], "reference/car0.ply"),
        ("car0.las", b"LASF and no more", "reference/car0.las: expected a LAS cloud"),
        ("car0.laz", b"", "reference/car0.laz: expected a LAZ cloud"),
        ("car0.e57", b"ASTM-E57 and no more", "reference/car0.e57: expected an E57 cloud"),
        ("car0.pcd", b"VERSION 0.7\n", "reference/car0.pcd: expected a PCD cloud"),
        ("car0.xyz", b"1 2 3\n1 two 3\n", "reference/car0.xyz:2: expected rows"),
        (
            "car0.XYZ",
            b"# none\n",
            "reference/car0.XYZ: expected rows that begin with x, y, z, found \"no point\"",
        ),
    ] {
        let place = tempfile::tempdir().unwrap();
        problem(place.path(), &[(name, bytes)]);
        let said = program().arg("check").arg(place.path()).assert().code(3);
        said.stderr(predicate::str::contains(found).and(predicate::str::contains("panicked").not()));
    }
}

#[test]
fn two_scans_of_a_vehicle_are_refused() {
    let place = tempfile::tempdir().unwrap();
    problem(place.path(), &[("car0.ply", MESH), ("car0.xyz", b"1 2 3\n")]);
    let said = program().arg("check").arg(place.path()).assert().code(3);
    said.stderr(predicate::str::contains("car0.ply, car0.xyz"));
}
