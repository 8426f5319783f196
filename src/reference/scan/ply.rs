//! PLY: ASCII and binary of either byte order, points of any numeric type, faces of any size.

use super::{Cloud, Refusal};
use nalgebra::Point3;
use ply_rs_bw::parser::{ParseError, Parser, Reader};
use ply_rs_bw::ply::{ElementDef, Encoding, PropertyAccess, PropertyAccessResult, PropertyType, ScalarType};

/// Implements the setters of numbers, or of lists, of other types by that of the widest type.
macro_rules! widened {
    ($wide:ident: $($name:ident $kind:ty),+) => {
        $(fn $name(&mut self, name: &str, value: $kind) -> PropertyAccessResult {
            self.$wide(name, value.into())
        })+
    };
    (list $wide:ident: $($name:ident $kind:ty),+) => {
        $(fn $name(&mut self, name: &str, value: Vec<$kind>) -> PropertyAccessResult {
            self.$wide(name, value.into_iter().map(i64::from))
        })+
    };
}

/// A vertex; a coordinate that the file does not give stays not a number.
#[derive(Debug)]
struct Vertex([f64; 3]);

impl PropertyAccess for Vertex {
    fn new() -> Self {
        Vertex([f64::NAN; 3])
    }

    fn set_double(&mut self, name: &str, value: f64) -> PropertyAccessResult {
        let axis = match name {
            "x" => 0,
            "y" => 1,
            "z" => 2,
            _ => return PropertyAccessResult::Ignored,
        };
        self.0[axis] = value;
        PropertyAccessResult::Set
    }

    widened!(set_double: set_char i8, set_uchar u8, set_short i16, set_ushort u16, set_int i32,
        set_uint u32, set_float f32);
}

/// The corners of a face.
#[derive(Debug)]
struct Face(Vec<i64>);

impl Face {
    fn set(&mut self, name: &str, corners: impl Iterator<Item = i64>) -> PropertyAccessResult {
        if name != "vertex_indices" && name != "vertex_index" {
            return PropertyAccessResult::Ignored;
        }
        self.0 = corners.collect();
        PropertyAccessResult::Set
    }
}

impl PropertyAccess for Face {
    fn new() -> Self {
        Face(Vec::new())
    }

    widened!(list set: set_list_char i8, set_list_uchar u8, set_list_short i16, set_list_ushort u16,
        set_list_int i32, set_list_uint u32);
}

/// An element of no interest.
#[derive(Debug)]
struct Other;

impl PropertyAccess for Other {
    fn new() -> Self {
        Other
    }
}

/// Bytes that one of these elements has at the least.
fn least_size(element: &ElementDef, encoding: Encoding) -> u128 {
    let size = |kind: &ScalarType| match kind {
        ScalarType::Char | ScalarType::UChar => 1,
        ScalarType::Short | ScalarType::UShort => 2,
        ScalarType::Int | ScalarType::UInt | ScalarType::Float => 4,
        ScalarType::Double => 8,
    };
    let properties = element.properties.values().map(|property| match (&property.data_type, encoding) {
        (_, Encoding::Ascii) => 1,
        (PropertyType::Scalar(kind) | PropertyType::List(kind, _), _) => size(kind),
    });
    properties.sum::<u128>().max(1)
}

pub(super) fn read(bytes: &[u8]) -> Result<Cloud, Refusal> {
    let mut reader = Reader::new(bytes);
    let header = Parser::<Other>::new().read_header(&mut reader)?;
    let vertices = header.elements.get("vertex").ok_or("no element \"vertex\"")?;
    for axis in ["x", "y", "z"] {
        match vertices.properties.get(axis).map(|property| &property.data_type) {
            Some(PropertyType::Scalar(_)) => {}
            Some(PropertyType::List(..)) => return Err(format!("a list as property {axis:?}").into()),
            None => return Err(format!("no property {axis:?}").into()),
        }
    }
    let held = reader.get_ref().len();
    for element in header.elements.values() {
        let size = element.count as u128 * least_size(element, header.encoding);
        if size > held as u128 {
            let found = format!("{} elements {:?} in {held} bytes", element.count, element.name);
            return Err(found.into());
        }
    }
    let (mut points, mut faces) = (Vec::new(), Vec::new());
    let refused = |error: ParseError| match header.encoding {
        Encoding::Ascii => Refusal { line: error.line().map(|line| line as u64), found: error.to_string() },
        _ => error.into(),
    };
    for (name, element) in &header.elements {
        match name.as_str() {
            "vertex" => {
                points = Parser::<Vertex>::new()
                    .read_payload_for_element(&mut reader, element, &header)
                    .map_err(refused)?;
            }
            "face" => {
                faces = Parser::<Face>::new()
                    .read_payload_for_element(&mut reader, element, &header)
                    .map_err(refused)?;
            }
            _ => {
                let parser = Parser::<Other>::new();
                parser.read_payload_for_element(&mut reader, element, &header).map_err(refused)?;
            }
        }
    }
    if let Some(at) = points.iter().position(|Vertex(p)| !p.iter().all(|v| v.is_finite())) {
        return Err(format!("vertex {at} is {:?}", points[at].0).into());
    }
    let triangles = triangles(&faces, points.len())?;
    let points = points.into_iter().map(|Vertex(p)| Point3::from(p)).collect();
    Ok(Cloud { points, triangles, skipped: 0 })
}

/// Each face as a fan about its first corner.
fn triangles(faces: &[Face], points: usize) -> Result<Vec<[u32; 3]>, String> {
    let mut triangles = Vec::with_capacity(faces.len());
    for (at, Face(corners)) in faces.iter().enumerate() {
        let corner = |corner: &i64| match u32::try_from(*corner) {
            Ok(index) if (index as usize) < points => Ok(index),
            _ => Err(format!("face {at} has vertex {corner} of {points}")),
        };
        let corners: Vec<u32> = corners.iter().map(corner).collect::<Result<_, _>>()?;
        if let Some((&first, rest)) = corners.split_first() {
            triangles.extend(rest.windows(2).map(|edge| [first, edge[0], edge[1]]));
        }
    }
    Ok(triangles)
}
