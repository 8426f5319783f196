//! How a receiver came to a position.

/// Kinds of positions, from the worst to the best.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Quality {
    /// None, or not measured: typed in, simulated.
    Invalid,
    /// Dead reckoning.
    Estimated,
    /// Code of one receiver.
    Single,
    /// With corrections from satellites.
    Sbas,
    /// Code with corrections from a base.
    Dgps,
    /// Precise point positioning.
    Ppp,
    /// Phase, with ambiguities that are not whole.
    Float,
    /// Phase, with whole ambiguities.
    Fixed,
}

/// All of them and their names, the best first.
pub const QUALITIES: [(Quality, &str); 8] = [
    (Quality::Fixed, "fixed"),
    (Quality::Float, "float"),
    (Quality::Ppp, "ppp"),
    (Quality::Dgps, "dgps"),
    (Quality::Sbas, "sbas"),
    (Quality::Single, "single"),
    (Quality::Estimated, "estimated"),
    (Quality::Invalid, "invalid"),
];

impl Quality {
    /// Its name.
    pub fn name(self) -> &'static str {
        QUALITIES.iter().find(|(quality, _)| *quality == self).map_or("invalid", |(_, name)| name)
    }

    /// That with this name.
    pub fn named(name: &str) -> Option<Self> {
        QUALITIES.iter().find(|(_, known)| *known == name).map(|(quality, _)| *quality)
    }

    /// That of a flag `Q` of RTKLIB: 1 to 6, 0 being none.
    pub fn of_rtklib(flag: u32) -> Option<Self> {
        let known = ["invalid", "fixed", "float", "sbas", "dgps", "single", "ppp"]
            .get(usize::try_from(flag).ok()?)?;
        Quality::named(known)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_best_comes_first_and_names_lead_back() {
        assert!(QUALITIES.windows(2).all(|pair| pair[0].0 > pair[1].0));
        assert!(QUALITIES.iter().all(|(quality, name)| Quality::named(name) == Some(*quality)));
        assert!(QUALITIES.iter().all(|(quality, name)| quality.name() == *name));
        assert_eq!(Quality::named("fix"), None);
        assert_eq!((Quality::of_rtklib(1), Quality::of_rtklib(7)), (Some(Quality::Fixed), None));
        assert_eq!(
            (Quality::of_rtklib(2), Quality::of_rtklib(6)),
            (Some(Quality::Float), Some(Quality::Ppp))
        );
    }
}
