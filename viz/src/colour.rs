//! Colours, after Okabe and Ito: what is compared differs in brightness too.

/// Red, green, blue, opacity.
pub type Colour = u32;
pub const BEFORE: Colour = 0xC87F_00FF;
pub const AFTER: Colour = 0x56B4_E9FF;
pub const CONTROL: Colour = 0x009E_73FF;
pub const CHECK: Colour = 0xCC79_A7FF;
pub const TIE: Colour = 0xAAAA_AAFF;
pub const OBSERVED: Colour = 0xF0E4_42FF;
pub const REJECTED: Colour = 0xD55E_00FF;
pub const RESIDUAL: Colour = 0xFFFF_FFFF;
/// What the result is compared with.
pub const REFERENCE: Colour = 0xF0E4_42FF;
/// What nothing determines.
pub const OPEN_DIRECTION: Colour = 0xFF4D_A6FF;
/// A state between the first and the last one.
pub const ON_THE_WAY: Colour = 0xFFFF_FFFF;
/// To either side of a curve, thinner than it.
pub const BAND: Colour = 0xCCCC_CCFF;
/// Lines of the ground, and the ground between them.
pub const GROUND: Colour = 0xB08D_57FF;
pub const GROUND_BETWEEN: Colour = 0x3A33_2AFF;
/// Behind everything in three dimensions.
pub const BACKGROUND: Colour = 0x1419_1FFF;
pub const ELLIPSOID: Colour = 0xFFFF_FFFF;
/// Three axes that differ in brightness.
pub const AXES: [Colour; 3] = [0xD55E_00FF, 0x56B4_E9FF, 0xF0E4_42FF];
/// Of scenes that are compared.
pub const SCENES: [Colour; 4] = [AFTER, 0xD55E_00FF, 0xF0E4_42FF, 0x009E_73FF];

/// Upper limits of the classes of standard deviations and distances \[m\], and their colours from bright and good to
/// dark and poor (viridis, its end lightened for a dark background); grey where nothing determines it.
const CLASSES: [(f64, Colour); 4] =
    [(0.01, 0xFDE7_25FF), (0.02, 0x5EC9_62FF), (0.05, 0x2191_8CFF), (0.10, 0x3E6F_B5FF)];
const POOR: Colour = 0x7B3F_9EFF;
const OPEN: Colour = 0x5555_55FF;

/// The colour of a point with these standard deviations \[m\], by the largest of them.
pub fn of_sigma(sigma_m: [f64; 3]) -> Colour {
    of_length(sigma_m.into_iter().fold(0.0, f64::max))
}

/// The colour of a standard deviation or a distance \[m\].
pub fn of_length(length_m: f64) -> Colour {
    match CLASSES.iter().find(|(limit, _)| length_m <= *limit) {
        Some((_, colour)) => *colour,
        None if length_m.is_finite() => POOR,
        None => OPEN,
    }
}
