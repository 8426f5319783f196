//! Shapes, and clouds with values at their points, as PLY files.

use super::File;
use super::rounding::metres;
use crate::estimate::VehicleEstimate;
use crate::evaluate::shape::{ComparedPoint, ShapeComparison};
use crate::problem::Vehicle;
use nalgebra::Point3;
use ply_rs_bw::ply::{
    Addable, ElementDef, Encoding, Ply, PropertyAccess, PropertyDef, PropertyType, ScalarType,
};
use ply_rs_bw::writer::Writer;

const PROPERTIES: [&str; 6] = ["x", "y", "z", "sigma_x", "sigma_y", "sigma_z"];

/// A vertex: coordinates in the vehicle frame and their standard deviations \[m\].
#[derive(Debug)]
struct Vertex([f64; 6]);

impl PropertyAccess for Vertex {
    fn new() -> Self {
        Vertex([0.0; 6])
    }

    fn get_double(&self, name: &str) -> Option<f64> {
        PROPERTIES.iter().position(|property| *property == name).map(|at| self.0[at])
    }
}

/// The points of a vehicle that have coordinates, in the order of its table, as an ASCII PLY file. A
/// standard deviation that was not computed is `NaN`.
pub fn shape(vehicle: &Vehicle, estimate: &VehicleEstimate, sigmas: &[Option<[f64; 3]>]) -> Vec<u8> {
    let mut ply = Ply::<Vertex>::new();
    ply.header.encoding = Encoding::Ascii;
    let id: String = vehicle.id.chars().filter(char::is_ascii_graphic).collect();
    ply.header.comments.push(format!("shape of {id} in its frame (x forward, y left, z up), metres"));
    let mut element = ElementDef::new("vertex".to_owned());
    for property in PROPERTIES {
        let kind = PropertyType::Scalar(ScalarType::Double);
        element.properties.add(PropertyDef::new(property.to_owned(), kind));
    }
    ply.header.elements.add(element);
    let vertex = |(at, point): (usize, &Option<Point3<f64>>)| {
        let p = (*point)?;
        let [x, y, z] = sigmas.get(at).copied().flatten().unwrap_or([f64::NAN; 3]);
        Some(Vertex([metres(p.x), metres(p.y), metres(p.z), metres(x), metres(y), metres(z)]))
    };
    let vertices = estimate.points.iter().enumerate().filter_map(vertex).collect();
    ply.payload.insert("vertex".to_owned(), vertices);
    let mut bytes = Vec::new();
    Writer::new().write_ply(&mut bytes, &mut ply).expect("writing a consistent cloud to memory");
    bytes
}

/// Points with values that belong to them, as a binary PLY file (little endian, all in 64 bits). A
/// value that is not known is `NaN`.
///
/// A field is the property `scalar_<name>`, blanks of its name as underscores: what CloudCompare writes.
/// In the dialog with which it opens such a file, all fields are already chosen; it shows them under
/// their bare names, and the points in the colours of the first (`PlyFilter.cpp`). There, a name with
/// `nx`, `ny`, `nz`, `red`, `green` or `blue` in it, such as "measured", is taken for a normal or a
/// colour: no field may have one. Every field has a value for each point.
pub fn cloud_with_scalars(points: &[Point3<f64>], scalars: &[(&str, Vec<Option<f64>>)]) -> Vec<u8> {
    let mut header =
        format!("ply\nformat binary_little_endian 1.0\ncomment metres\nelement vertex {}\n", points.len());
    for axis in ["x", "y", "z"] {
        header += &format!("property double {axis}\n");
    }
    for (name, values) in scalars {
        assert_eq!(values.len(), points.len(), "a value of {name:?} for each point");
        debug_assert!(is_scalar_to_others(name), "{name:?} is not taken for a scalar field");
        header += &format!("property double scalar_{}\n", name.replace(' ', "_"));
    }
    header += "end_header\n";
    let mut bytes = header.into_bytes();
    bytes.reserve(8 * points.len() * (3 + scalars.len()));
    for (at, point) in points.iter().enumerate() {
        let values = scalars.iter().map(|(_, values)| values[at].unwrap_or(f64::NAN));
        for value in point.iter().copied().chain(values) {
            bytes.extend(value.to_le_bytes());
        }
    }
    bytes
}

/// Whether a name is one word of a header, and none that is taken for a normal or a colour.
fn is_scalar_to_others(name: &str) -> bool {
    let taken = ["nx", "ny", "nz", "red", "green", "blue"];
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "_ .-".contains(c);
    let property = format!("scalar_{}", name.replace(' ', "_").to_lowercase());
    name.chars().all(is_plain) && !taken.iter().any(|taken| property.contains(taken))
}

/// The points of a shape and of its scan, each with its distance to the other.
pub fn distance_clouds(found: &ShapeComparison) -> [File; 2] {
    let places: Vec<Point3<f64>> = found.points.iter().map(|p| p.in_scan).collect();
    let field = |of: fn(&ComparedPoint) -> Option<f64>| found.points.iter().map(of).collect::<Vec<_>>();
    let shape = cloud_with_scalars(
        &places,
        &[
            ("distance_m", field(|p| Some(p.nearest_m))),
            ("to_plane_m", field(|p| Some(p.plane_m))),
            ("to_mesh_m", field(|p| p.mesh_m)),
            ("sigma_m", field(|p| p.sigma_m)),
        ],
    );
    let back = found.from_scan_m.iter().copied().map(Some).collect();
    let scan = cloud_with_scalars(&found.scan, &[("distance_m", back)]);
    let vehicle = &found.vehicle;
    [(format!("shape_{vehicle}.ply"), shape), (format!("scan_{vehicle}.ply"), scan)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use ply_rs_bw::parser::Parser;
    use ply_rs_bw::ply::{DefaultElement, Property};

    #[test]
    fn a_cloud_carries_its_values() {
        let points = [Point3::new(500_000.123_456_789, -2.0, 0.5), Point3::new(1e-9, 3.0, 4.0)];
        let scalars = [("distance to scan", vec![Some(0.05), None]), ("sigma", vec![Some(1.0), Some(2.0)])];
        let bytes = cloud_with_scalars(&points, &scalars);
        let ply = Parser::<DefaultElement>::new().read_ply(&mut bytes.as_slice()).unwrap();
        let names: Vec<&str> = ply.header.elements["vertex"].properties.keys().map(String::as_str).collect();
        assert_eq!(names, ["x", "y", "z", "scalar_distance_to_scan", "scalar_sigma"]);
        let value = |at: usize, name: &str| match ply.payload["vertex"][at][name] {
            Property::Double(value) => value,
            ref other => panic!("{other:?}"),
        };
        for (at, point) in points.iter().enumerate() {
            assert_eq!([value(at, "x"), value(at, "y"), value(at, "z")], [point.x, point.y, point.z]);
        }
        assert_eq!((value(0, "scalar_distance_to_scan"), value(1, "scalar_sigma")), (0.05, 2.0));
        assert!(value(1, "scalar_distance_to_scan").is_nan());
    }

    #[test]
    fn names_that_others_take_for_colours_are_known() {
        for (name, is_scalar) in [
            ("distance_m", true),
            ("measured", false),
            ("REDUCED", false),
            ("any", false),
            ("in x", true),
            ("a\nb", false),
        ] {
            assert_eq!(is_scalar_to_others(name), is_scalar, "{name}");
        }
    }
}
