use super::{FORMATS, Scan, read_cloud};
use crate::tables::{Finding, Findings};
use nalgebra::Point3;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::io::Cursor;

const LITTLE: &str = "binary_little_endian";
const BIG: &str = "binary_big_endian";

/// Points of a car about `origin`, no two coordinates alike.
fn car(count: usize, origin: [f64; 3]) -> Vec<Point3<f64>> {
    let point = |k: usize| {
        let t = k as f64 * 0.37;
        let p = Point3::new(2.3 * t.sin(), 0.9 * (1.7 * t).cos(), 0.75 + 0.7 * (0.31 * t).sin());
        p + nalgebra::Vector3::from(origin)
    };
    (0..count).map(point).collect()
}

const LOCAL: [f64; 3] = [0.0; 3];
const UTM: [f64; 3] = [500_000.0, 3_900_000.0, 37.0];

fn parse(extension: &str, bytes: &[u8]) -> Result<Scan, Finding> {
    let place = tempfile::tempdir().unwrap();
    let path = place.path().join("scan");
    std::fs::write(&path, bytes).unwrap();
    read_cloud(&path, &format!("reference/car1.{extension}"))
}

/// A PLY file. A vertex has a property of another type in front of its coordinates.
fn ply(points: &[Point3<f64>], encoding: &str, kind: &str) -> Vec<u8> {
    let count = points.len();
    let mut bytes = format!(
        "ply\nformat {encoding} 1.0\ncomment c\nelement vertex {count}\nproperty uchar red\n\
         property {kind} x\nproperty {kind} y\nproperty {kind} z\nend_header\n"
    )
    .into_bytes();
    for p in points {
        let is_single = kind == "float";
        match encoding {
            "ascii" if is_single => {
                bytes.extend(format!("7 {} {} {}\n", p.x as f32, p.y as f32, p.z as f32).bytes())
            }
            "ascii" => bytes.extend(format!("7 {} {} {}\n", p.x, p.y, p.z).bytes()),
            _ => {
                bytes.push(7);
                for v in p.iter() {
                    match (encoding == LITTLE, is_single) {
                        (true, true) => bytes.extend((*v as f32).to_le_bytes()),
                        (true, false) => bytes.extend(v.to_le_bytes()),
                        (false, true) => bytes.extend((*v as f32).to_be_bytes()),
                        (false, false) => bytes.extend(v.to_be_bytes()),
                    }
                }
            }
        }
    }
    bytes
}

/// A LAS or LAZ file with a scale of a millimetre.
fn las(points: &[Point3<f64>], version: (u8, u8), format: u8, is_compressed: bool) -> Vec<u8> {
    let mut builder = las::Builder::from(version);
    builder.point_format = las::point::Format::new(format).unwrap();
    builder.point_format.is_compressed = is_compressed;
    let offset = points.first().map_or(Point3::origin(), |p| p.map(f64::floor));
    let axis = |offset| las::Transform { scale: 0.001, offset };
    builder.transforms = las::Vector { x: axis(offset.x), y: axis(offset.y), z: axis(offset.z) };
    let mut writer = las::Writer::new(Cursor::new(Vec::new()), builder.into_header().unwrap()).unwrap();
    let has = writer.header().point_format().to_owned();
    for p in points {
        let gps_time = has.has_gps_time.then_some(1.0);
        let color = has.has_color.then(|| las::Color::new(1, 2, 3));
        let point = las::Point { x: p.x, y: p.y, z: p.z, gps_time, color, ..Default::default() };
        writer.write_point(point).unwrap();
    }
    writer.into_inner().unwrap().into_inner()
}

/// An E57 file of double, single, or integers of a scale of a millimetre.
fn e57(points: &[Point3<f64>], kind: &e57::RecordDataType, pose: Option<e57::Transform>) -> Vec<u8> {
    use e57::{Record, RecordDataType, RecordName, RecordValue};
    let mut bytes = Cursor::new(Vec::new());
    let mut file = e57::E57Writer::new(&mut bytes, "file").unwrap();
    let names = [RecordName::CartesianX, RecordName::CartesianY, RecordName::CartesianZ];
    let mut prototype: Vec<Record> =
        names.into_iter().map(|name| Record { name, data_type: kind.clone() }).collect();
    let state = RecordDataType::Integer { min: 0, max: 2 };
    prototype.push(Record { name: RecordName::CartesianInvalidState, data_type: state });
    let mut writer = file.add_pointcloud("cloud", prototype).unwrap();
    writer.set_transform(pose);
    for p in points {
        let value = |v: f64| match kind {
            RecordDataType::Single { .. } => RecordValue::Single(v as f32),
            RecordDataType::Double { .. } => RecordValue::Double(v),
            RecordDataType::ScaledInteger { scale, offset, .. } => {
                RecordValue::ScaledInteger(((v - offset) / scale).round() as i64)
            }
            RecordDataType::Integer { .. } => RecordValue::Integer(v.round() as i64),
        };
        let state = if p.x.is_nan() { 2 } else { 0 };
        let at = if p.x.is_nan() { Point3::origin() } else { *p };
        let values = vec![value(at.x), value(at.y), value(at.z), RecordValue::Integer(state)];
        writer.add_point(values).unwrap();
    }
    writer.finalize().unwrap();
    file.finalize().unwrap();
    drop(file);
    bytes.into_inner()
}

const DOUBLE: e57::RecordDataType = e57::RecordDataType::F64;
const SINGLE: e57::RecordDataType = e57::RecordDataType::F32;
const MILLIMETRES: e57::RecordDataType =
    e57::RecordDataType::ScaledInteger { min: -(1 << 33), max: 1 << 33, scale: 0.001, offset: 0.0 };

/// A PCD file. A point has a field of another type in front of its coordinates.
fn pcd(points: &[Point3<f64>], data_kind: pcd_rs::DataKind, is_single: bool) -> Vec<u8> {
    use pcd_rs::{DynRecord, Field, Schema, ValueKind, WriterInit};
    let kind = if is_single { ValueKind::F32 } else { ValueKind::F64 };
    let schema = [("ring", ValueKind::U16, 1), ("x", kind, 1), ("y", kind, 1), ("z", kind, 1)];
    let init = WriterInit {
        width: points.len() as u64,
        height: 1,
        viewpoint: Default::default(),
        data_kind,
        schema: Some(Schema::from_iter(schema)),
        version: None,
    };
    let mut bytes = Cursor::new(Vec::new());
    let mut writer = init.build_from_writer(&mut bytes).unwrap();
    for p in points {
        let value = |v: f64| if is_single { Field::F32(vec![v as f32]) } else { Field::F64(vec![v]) };
        writer.push(&DynRecord(vec![Field::U16(vec![3]), value(p.x), value(p.y), value(p.z)])).unwrap();
    }
    writer.finish().unwrap();
    bytes.into_inner()
}

fn xyz(points: &[Point3<f64>], separator: &str) -> Vec<u8> {
    let line = |p: &Point3<f64>| format!("{}{separator}{}{separator}{}{separator}12 # c\n", p.x, p.y, p.z);
    points.iter().map(line).collect::<String>().into_bytes()
}

/// How far a coordinate may be off in a format.
#[derive(Clone, Copy)]
enum Resolution {
    /// Not at all.
    Exact,
    /// Rounded to 32 bits.
    Single,
    /// Rounded to a millimetre.
    Millimetre,
}

use Resolution::{Exact, Millimetre, Single};

/// The cloud in every format: what it is, extension, resolution, and bytes.
fn all(points: &[Point3<f64>]) -> Vec<(&'static str, &'static str, Resolution, Vec<u8>)> {
    use pcd_rs::DataKind::{Ascii, Binary, BinaryCompressed};
    vec![
        ("PLY, ASCII, float", "ply", Single, ply(points, "ascii", "float")),
        ("PLY, ASCII, double", "ply", Exact, ply(points, "ascii", "double")),
        ("PLY, little endian, float", "PLY", Single, ply(points, LITTLE, "float")),
        ("PLY, little endian, double", "ply", Exact, ply(points, LITTLE, "double")),
        ("PLY, big endian, float", "ply", Single, ply(points, BIG, "float")),
        ("PLY, big endian, double", "ply", Exact, ply(points, BIG, "double")),
        ("LAS 1.2", "las", Millimetre, las(points, (1, 2), 0, false)),
        ("LAS 1.4", "LAS", Millimetre, las(points, (1, 4), 7, false)),
        ("LAZ 1.2", "laz", Millimetre, las(points, (1, 2), 3, true)),
        ("LAZ 1.4", "laz", Millimetre, las(points, (1, 4), 7, true)),
        ("E57, double", "e57", Exact, e57(points, &DOUBLE, None)),
        ("E57, float", "e57", Single, e57(points, &SINGLE, None)),
        ("E57, integer", "E57", Millimetre, e57(points, &MILLIMETRES, None)),
        ("PCD, ASCII, float", "pcd", Single, pcd(points, Ascii, true)),
        ("PCD, ASCII, double", "pcd", Exact, pcd(points, Ascii, false)),
        ("PCD, binary, float", "pcd", Single, pcd(points, Binary, true)),
        ("PCD, binary, double", "pcd", Exact, pcd(points, Binary, false)),
        ("PCD, compressed, float", "pcd", Single, pcd(points, BinaryCompressed, true)),
        ("PCD, compressed, double", "pcd", Exact, pcd(points, BinaryCompressed, false)),
        ("XYZ, blanks", "xyz", Exact, xyz(points, " ")),
        ("XYZ, commas", "xyz", Exact, xyz(points, ",")),
        ("XYZ, semicolons", "xyz", Exact, xyz(points, "; ")),
    ]
}

#[test]
fn one_cloud_is_the_same_in_every_format() {
    // More points than a chunk of LAZ holds, or a packet of E57.
    for (count, origin) in [(60_001, LOCAL), (500, UTM)] {
        let points = car(count, origin);
        for (name, extension, resolution, bytes) in all(&points) {
            let scan = parse(extension, &bytes).unwrap_or_else(|e| panic!("{name}: {e}"));
            assert_eq!(scan.points.len(), count, "{name}");
            assert_eq!((scan.skipped, scan.triangles.len()), (0, 0), "{name}");
            let mut worst: f64 = 0.0;
            for (found, wanted) in scan.points.iter().zip(&points) {
                for (found, wanted) in found.iter().zip(wanted.iter()) {
                    match resolution {
                        Exact => assert_eq!(found, wanted, "{name}"),
                        Single => assert_eq!(*found, f64::from(*wanted as f32), "{name}"),
                        Millimetre => {
                            let off = (found - wanted).abs();
                            assert!(off <= 0.5e-3 + 2.0 * f64::EPSILON * wanted.abs(), "{name}: {off}");
                            worst = worst.max(off);
                        }
                    }
                }
            }
            assert!(!matches!(resolution, Millimetre) || worst > 0.49e-3, "{name}: {worst}");
        }
    }
}

#[test]
fn a_ply_mesh_gives_its_triangles() {
    let head = "element vertex 5\nproperty short x\nproperty int y\nproperty uchar z\nelement edge 1\n\
                property list uchar float w\nelement face 3\nproperty list uchar int vertex_indices\n\
                property uchar red\nend_header\n";
    let text = "ply\nformat ascii 1.0\n".to_owned()
        + head
        + "0 0 0\n1 0 0\n1 1 0\n0 1 0\n-3 70000 255\n2 0.5 1\n3 0 1 4 9\n4 0 1 2 3 9\n2 0 1 9\n";
    let scan = parse("ply", text.as_bytes()).unwrap();
    assert_eq!(scan.points[4], Point3::new(-3.0, 70000.0, 255.0));
    assert_eq!(scan.triangles, [[0, 1, 4], [0, 1, 2], [0, 2, 3]]);

    let mut bytes = format!("ply\nformat {LITTLE} 1.0\n{head}").into_bytes();
    for [x, y, z] in [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [-3, 70000, 255]] {
        bytes.extend((x as i16).to_le_bytes());
        bytes.extend(i32::to_le_bytes(y));
        bytes.push(z as u8);
    }
    bytes.push(1);
    bytes.extend(0.5_f32.to_le_bytes());
    for corners in [&[0, 1, 4][..], &[0, 1, 2, 3], &[0, 1]] {
        bytes.push(corners.len() as u8);
        corners.iter().for_each(|corner: &i32| bytes.extend(corner.to_le_bytes()));
        bytes.push(9);
    }
    assert_eq!(parse("ply", &bytes).unwrap(), scan);
    for corner in ["5", "-1", "99999999999"] {
        let damaged = text.replace("4 0 1 2 3", &format!("4 0 1 2 {corner}"));
        assert!(parse("ply", damaged.as_bytes()).is_err(), "{corner}");
    }
}

/// The pose of a scanner, `world_from_scan`, as its file has it and as a motion.
fn pose() -> (e57::Transform, nalgebra::Isometry3<f64>) {
    let rotation = nalgebra::UnitQuaternion::from_euler_angles(0.3, -0.2, 2.1);
    let isometry = nalgebra::Isometry3::from_parts(nalgebra::Translation3::new(10.0, -20.0, 1.5), rotation);
    let q = e57::Quaternion { w: rotation.w, x: rotation.i, y: rotation.j, z: rotation.k };
    (e57::Transform { rotation: q, translation: e57::Translation { x: 10.0, y: -20.0, z: 1.5 } }, isometry)
}

#[test]
fn the_pose_of_an_e57_scan_is_applied_and_its_invalid_points_are_counted() {
    let (transform, world_from_scan) = pose();
    let mut points = car(400, LOCAL);
    points[7].x = f64::NAN;
    points[399].x = f64::NAN;
    let scan = parse("e57", &e57(&points, &DOUBLE, Some(transform.clone()))).unwrap();
    assert_eq!((scan.points.len(), scan.skipped), (398, 2));
    let valid = points.iter().filter(|p| !p.x.is_nan());
    for (found, wanted) in scan.points.iter().zip(valid) {
        assert!((found - world_from_scan * wanted).norm() < 1e-13);
    }
    let mut stretched = transform;
    stretched.rotation.w *= 1.1;
    let finding = parse("e57", &e57(&points, &DOUBLE, Some(stretched))).unwrap_err();
    assert!(finding.found.contains("pose"), "{finding}");
}

#[test]
fn an_e57_scan_in_angles_is_read() {
    use e57::{Record, RecordDataType, RecordName, RecordValue};
    let mut bytes = Cursor::new(Vec::new());
    let mut file = e57::E57Writer::new(&mut bytes, "file").unwrap();
    let names = [RecordName::SphericalRange, RecordName::SphericalAzimuth, RecordName::SphericalElevation];
    let record = |name| Record { name, data_type: RecordDataType::F64 };
    let mut writer = file.add_pointcloud("cloud", names.map(record).to_vec()).unwrap();
    let points = car(50, [3.0, 1.0, 0.5]);
    for p in &points {
        let range = p.coords.norm();
        let values = [range, p.y.atan2(p.x), (p.z / range).asin()];
        writer.add_point(values.map(RecordValue::Double).to_vec()).unwrap();
    }
    writer.finalize().unwrap();
    file.finalize().unwrap();
    drop(file);
    let scan = parse("e57", &bytes.into_inner()).unwrap();
    assert_eq!(scan.points.len(), 50);
    for (found, wanted) in scan.points.iter().zip(&points) {
        assert!((found - wanted).norm() < 1e-14 * wanted.coords.norm() * 4.0);
    }
}

#[test]
fn missing_points_of_a_pcd_scan_are_counted() {
    let mut points = car(30, LOCAL);
    points[4].y = f64::NAN;
    points[29].z = f64::INFINITY;
    for kind in [pcd_rs::DataKind::Ascii, pcd_rs::DataKind::Binary, pcd_rs::DataKind::BinaryCompressed] {
        let scan = parse("pcd", &pcd(&points, kind, true)).unwrap();
        assert_eq!((scan.points.len(), scan.skipped), (28, 2));
        assert_eq!(scan.points[4], points[5].map(|v| f64::from(v as f32)));
    }
    points.iter_mut().for_each(|p| p.x = f64::NAN);
    let finding = parse("pcd", &pcd(&points, pcd_rs::DataKind::Binary, true)).unwrap_err();
    assert_eq!(finding.found, "no point that has coordinates");
}

#[test]
fn lines_of_an_xyz_scan_are_taken_apart() {
    let read = |text: &str| parse("xyz", text.as_bytes());
    let points = [Point3::new(1.0, 2.0, -3.5), Point3::new(4e2, 5.0, 6.0)];
    for text in [
        "1 2 -3.5\n4e2 5 6",
        "# x\n\n1\t2   -3.5 0 0\r\n  4e2 5 6 # c\r\n",
        "//X Y Z\n1 2 -3.5 // c\n400 5 6\n",
        "x,y,z,i\n1,2,-3.5,9\n400, 5, 6, a b\n",
        "\u{feff}\"X\";\"Y\";\"Z\"\n1;2;-3.5\n400 ; 5 ; 6\n",
        "north east up\n1 2 -3.5\n400 5 6\n",
    ] {
        assert_eq!(read(text).unwrap().points, points, "{text:?}");
    }
    for (text, line, found) in [
        ("1 2 3\n1 two 3\n", 2, "two"),
        ("1 2 3\n1 2\n", 2, "1 2"),
        ("1 2 3\nx y z\n", 2, "x"),
        ("1 2 nan\n", 1, "nan"),
        ("1 2 3\n\n1 2 inf", 3, "inf"),
        ("1,5 2,5 3,5\n", 1, "5 2"),
        ("1,5;2,5;3,5\n", 1, "1,5"),
        ("id x y z\n7 1 2 3\n", 1, "id"),
        ("12\n1 2 3\n", 1, "12"),
    ] {
        let finding = read(text).unwrap_err();
        assert_eq!((finding.line, finding.found.as_str()), (Some(line), found), "{text:?}");
    }
    assert!(parse("xyz", b"1 2 3\n\xff 2 3\n").is_err());
    assert_eq!(read("# nothing\nx y z\n").unwrap_err().found, "no point");
}

#[test]
fn damaged_ply_scans_are_refused() {
    let cloud = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\n\
                 property double z\nend_header\n1 2 3\n4 5 6.5\n";
    assert!(parse("ply", cloud.as_bytes()).is_ok());
    for damaged in [
        String::new(),
        "no cloud at all".to_owned(),
        cloud.replace("vertex 2", "vertex 3"),
        cloud.replace("vertex 2", "vertex 0"),
        cloud.replace("vertex 2", "vertex 99999999999999999"),
        cloud.replace("property float x\n", ""),
        cloud.replace("property float x\n", "property list uchar float x\n"),
        cloud.replace("4 5 6.5", "4 nan 6.5"),
        cloud.replace("4 5 6.5", "4 five 6.5"),
        cloud.replace("element vertex", "element face"),
        cloud[..cloud.len() - 8].to_owned(),
        cloud.replace("ascii", LITTLE),
    ] {
        assert!(parse("ply", damaged.as_bytes()).is_err(), "{damaged}");
    }
    let finding = parse("ply", cloud.replace("5 6.5", "five 6.5").as_bytes()).unwrap_err();
    assert_eq!(finding.line, Some(9), "{finding}");
}

/// Headers that promise what no file of their size holds.
#[test]
fn promises_that_a_file_cannot_hold_are_refused() {
    let points = car(400, LOCAL);
    let replaced = |bytes: &[u8], at: usize, with: &[u8]| {
        let mut bytes = bytes.to_vec();
        bytes[at..at + with.len()].copy_from_slice(with);
        bytes
    };
    let most = u32::MAX.to_le_bytes();
    let whole = las(&points, (1, 4), 7, false);
    assert!(parse("las", &replaced(&whole, 107, &most)).is_err());
    let fives = replaced(&replaced(&whole, 107, &[0; 4]), 247, &u64::MAX.to_le_bytes());
    assert!(parse("las", &fives).unwrap_err().found.contains("18446744073709551615 points"));
    // An extended record of absurd length behind the points is not looked at.
    let mut extended =
        replaced(&replaced(&whole, 235, &(whole.len() as u64).to_le_bytes()), 243, &[1, 0, 0, 0]);
    extended.extend([0; 20]);
    extended.extend(u64::MAX.to_le_bytes());
    extended.extend([0; 32]);
    assert_eq!(parse("las", &extended).unwrap().points.len(), 400);

    let layered = las(&points, (1, 4), 7, true);
    let start = u32::from_le_bytes(layered[96..100].try_into().unwrap()) as usize;
    // The size of the second layer: behind the offset of the table, the first point, and two numbers.
    let damaged = replaced(&layered, start + 8 + 36 + 4 + 4, &most);
    assert!(parse("laz", &damaged).unwrap_err().found.contains("cut off in the chunks"));
    for whole in [layered, las(&points, (1, 2), 0, true)] {
        let start = u32::from_le_bytes(whole[96..100].try_into().unwrap()) as usize;
        let table = u64::from_le_bytes(whole[start..start + 8].try_into().unwrap()) as usize;
        let finding = parse("laz", &replaced(&whole, table + 4, &most)).unwrap_err();
        assert!(finding.found.contains("4294967295 chunks"), "{finding}");
        let finding = parse("laz", &replaced(&whole, 107, &60_000_u32.to_le_bytes())).unwrap_err();
        assert_eq!(finding.found, "60000 points, 50000 of them in chunks");
    }

    let text = String::from_utf8(pcd(&points, pcd_rs::DataKind::Ascii, true)).unwrap();
    for (from, to) in
        [("POINTS 400", "POINTS 18446744073709551615"), ("COUNT 1 1", "COUNT 18446744073709551615 1")]
    {
        assert!(text.contains(from));
        let finding = parse("pcd", text.replace(from, to).as_bytes()).unwrap_err();
        assert!(finding.found.contains("bytes of data"), "{finding}");
    }
    let packed = pcd(&points, pcd_rs::DataKind::BinaryCompressed, true);
    let place = |what: &[u8]| packed.windows(what.len()).position(|w| w == what).unwrap();
    let data = place(b"binary_compressed\n") + 18;
    let more_points = replaced(&packed, place(b"POINTS 400"), b"POINTS 401");
    // 299,999,999 points of 14 bytes that agree with the header, but not with what can be packed so.
    let mut inflated = String::from_utf8(packed[..data].to_vec()).unwrap();
    inflated = inflated.replace("POINTS 400", "POINTS 299999999");
    let sizes = [packed[data..data + 4].to_vec(), 4_199_999_986_u32.to_le_bytes().to_vec()].concat();
    let inflated = [inflated.as_bytes(), &sizes, &packed[data + 8..]].concat();
    let binary = pcd(&points, pcd_rs::DataKind::Binary, true);
    let short = binary[..binary.len() - 1].to_vec();
    let resized = [data, data + 4].map(|at| replaced(&packed, at, &most));
    for damaged in [more_points, inflated, short].into_iter().chain(resized) {
        let finding = parse("pcd", &damaged).unwrap_err();
        assert!(finding.found.contains("bytes of data"), "{finding}");
    }

    let vertices = "element vertex 1\nproperty uchar x\nproperty uchar y\nproperty uchar z\n";
    for element in ["element empty 99999999999\n", "element face 99\nproperty list uchar int vertex_index\n"]
    {
        let text = format!("ply\nformat {LITTLE} 1.0\n{vertices}{element}end_header\n123");
        let finding = parse("ply", text.as_bytes()).unwrap_err();
        assert!(finding.found.contains("elements"), "{finding}");
    }
}

#[test]
fn an_e57_cloud_of_no_bits_or_too_many_points_is_refused() {
    let rewritten = |change: &dyn Fn(&str) -> String| {
        let mut bytes = Cursor::new(Vec::new());
        let mut file = e57::E57Writer::new(&mut bytes, "file").unwrap();
        let prototype =
            vec![e57::Record::CARTESIAN_X_F64, e57::Record::CARTESIAN_Y_F64, e57::Record::CARTESIAN_Z_F64];
        let mut writer = file.add_pointcloud("cloud", prototype).unwrap();
        writer.add_point([1.0, 2.0, 3.0].map(e57::RecordValue::Double).to_vec()).unwrap();
        writer.finalize().unwrap();
        file.finalize_customized_xml(|xml| Ok(change(&xml))).unwrap();
        drop(file);
        parse("e57", &bytes.into_inner())
    };
    assert_eq!(rewritten(&str::to_owned).unwrap().points, [Point3::new(1.0, 2.0, 3.0)]);
    let finding =
        rewritten(&|xml| xml.replace("recordCount=\"1\"", "recordCount=\"99999999999\"")).unwrap_err();
    assert!(finding.found.contains("99999999999 points"), "{finding}");
    let constant = |xml: &str| {
        let mut xml = xml.to_owned();
        for axis in ["X", "Y", "Z"] {
            let from = format!("<cartesian{axis} type=\"Float\"");
            assert!(xml.contains(&from), "{xml}");
            xml =
                xml.replace(&from, &format!("<cartesian{axis} minimum=\"4\" maximum=\"4\" type=\"Integer\""));
        }
        xml
    };
    assert!(rewritten(&constant).unwrap_err().found.contains("0 bits"));
}

/// Cut off anywhere, or with bytes changed, a file is read or refused, but nothing panics and nothing
/// large is allocated.
#[test]
fn damaged_files_are_read_or_refused() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    for (name, extension, _, bytes) in all(&car(150, LOCAL)) {
        let (_, read, _) = FORMATS.iter().find(|(known, ..)| extension.eq_ignore_ascii_case(known)).unwrap();
        let mut refused = 0;
        for _ in 0..200 {
            refused += usize::from(read(&bytes[..rng.random_range(0..bytes.len())]).is_err());
        }
        assert!(refused >= 190 || extension == "xyz", "{name}: {refused}");
        for round in 0..600 {
            let mut damaged = bytes.clone();
            // Headers are short: half of the changes are there.
            let within = if round % 2 == 0 { bytes.len() } else { bytes.len().min(600) };
            for _ in 0..rng.random_range(1..6) {
                damaged[rng.random_range(0..within)] = rng.random();
            }
            let _ = read(&damaged);
        }
    }
}

#[test]
fn a_panic_of_the_decoder_is_a_refusal() {
    let refusal = super::las::unless_it_panics(|| panic!("of no interest")).unwrap_err();
    assert_eq!(refusal.found, "damaged compressed data");
}

#[test]
fn a_vehicle_has_one_scan() {
    let place = tempfile::tempdir().unwrap();
    let save = |name: &str, bytes: &[u8]| {
        let folder = place.path().join("reference");
        std::fs::create_dir_all(&folder).unwrap();
        std::fs::write(folder.join(name), bytes).unwrap();
    };
    let vehicles = ["b".to_owned(), "a.1".to_owned(), "c".to_owned()];
    save("a.1.XYZ", b"1 2 3\n");
    let mut points = car(3, LOCAL);
    points[0].x = f64::NAN;
    save("b.pcd", &pcd(&points, pcd_rs::DataKind::Ascii, true));
    save("a.ply", b"of no vehicle");
    let mut findings = Findings::default();
    let scans = super::read(place.path(), &vehicles, &mut findings);
    let named: Vec<(&str, &str)> = scans.iter().map(|(id, scan)| (id.as_str(), scan.file.as_str())).collect();
    assert_eq!(named, [("b", "reference/b.pcd"), ("a.1", "reference/a.1.XYZ")]);
    assert_eq!(findings.warnings(), ["reference/b.pcd: 1 of 3 points have no coordinates"]);
    assert!(!findings.is_invalid());
    save("b.las", b"");
    super::read(place.path(), &vehicles, &mut findings);
    let text = findings.to_string();
    assert!(text.contains("reference/b.las") && text.contains("b.las, b.pcd"), "{text}");
    assert!(read_cloud(place.path(), "reference/b.txt").unwrap_err().wanted.contains(".ply, .las"));
}
