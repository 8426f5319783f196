//! Colours that differ in brightness too (after Okabe and Ito).

/// Red, green, blue, opacity.
pub type Colour = u32;
pub const BEFORE: Colour = 0xE69F_00FF;
pub const AFTER: Colour = 0x56B4_E9FF;
pub const CONTROL: Colour = 0x009E_73FF;
pub const CHECK: Colour = 0xCC79_A7FF;
pub const TIE: Colour = 0xAAAA_AAFF;
pub const OBSERVED: Colour = 0xF0E4_42FF;
pub const REJECTED: Colour = 0xD55E_00FF;
pub const GROUND: Colour = 0x4646_46FF;
