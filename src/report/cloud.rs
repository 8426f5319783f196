//! Shapes as PLY clouds.

use super::rounding::metres;
use crate::estimate::VehicleEstimate;
use crate::problem::Vehicle;
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
    let vertex = |(at, point): (usize, &Option<nalgebra::Point3<f64>>)| {
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
