//! Numbers and texts as problem files have them.
//!
//! Numbers are rounded far below what they are known to, so that files stay small.

use crate::geometry::{Pose, quaternion_wxyz};
use crate::problem::Known;

/// Digits after the point of an image coordinate \[px\].
const PIXEL_DIGITS: i32 = 4;
/// ... of its standard deviation \[px\], ...
const SIGMA_PX_DIGITS: i32 = 6;
/// ... of a length \[m\], ...
const METRE_DIGITS: i32 = 6;
/// ... of a time \[s\], ...
const TIME_DIGITS: i32 = 7;
/// ... of a number of a quaternion.
const QUATERNION_DIGITS: i32 = 10;

/// Columns of a pose.
pub const POSE_COLUMNS: [&str; 7] = ["x", "y", "z", "qw", "qx", "qy", "qz"];

/// A number with so many digits after the point, without zeros at the end.
pub fn decimal(value: f64, digits: i32) -> String {
    let unit = 10_f64.powi(digits);
    let whole = (value * unit).round();
    // Adding zero takes the sign from -0.
    let rounded = if whole.is_finite() { whole / unit + 0.0 } else { value };
    format!("{rounded}")
}

/// A length.
pub fn metres(value: f64) -> String {
    decimal(value, METRE_DIGITS)
}

/// A time.
pub fn seconds(value: f64) -> String {
    decimal(value, TIME_DIGITS)
}

/// An image point and its standard deviation.
pub fn pixels(image_px: &nalgebra::Vector2<f64>, sigma_px: f64) -> [String; 3] {
    let pixel = |value: f64| decimal(value, PIXEL_DIGITS);
    [pixel(image_px.x), pixel(image_px.y), decimal(sigma_px, SIGMA_PX_DIGITS)]
}

/// The cells of a pose, in the order of [`POSE_COLUMNS`].
pub fn pose(pose: &Pose) -> [String; 7] {
    let [x, y, z]: [f64; 3] = pose.translation.vector.into();
    let [a, b, c, d] = quaternion_wxyz(pose).map(|v| decimal(v, QUATERNION_DIGITS));
    [metres(x), metres(y), metres(z), a, b, c, d]
}

/// A known coordinate and its standard deviation, or two empty cells.
pub fn number_sigma(known: Option<Known>) -> [String; 2] {
    known.map_or_else(Default::default, |k| [metres(k.value_m), metres(k.sigma_m)])
}

/// A text in TOML.
pub fn quoted(text: &str) -> String {
    toml::Value::String(text.to_owned()).to_string()
}
