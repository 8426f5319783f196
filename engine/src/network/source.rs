//! What a group of measurements is, and what follows from it: the one table that every room reads.

/// What a group of measurements is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Source {
    /// Image points of vehicles.
    VehicleImages,
    /// Image points of targets.
    TargetImages,
    /// Surveyed coordinates of targets.
    Survey,
    /// Contact of vehicles with the terrain, and its bias.
    Terrain,
    /// Known heights of bodies.
    KnownHeight,
    /// Known coordinates of shape points.
    KnownPoint,
    /// Known distances between shape points.
    KnownDistance,
    /// What is known of the interior orientation.
    Calibration,
    /// What is known of the readout time.
    Readout,
    /// GNSS positions.
    Gnss,
    /// What is known of clocks, lever arms and shifts of GNSS receivers.
    GnssKnowledge,
    /// Given camera poses whose standard deviations are known.
    CameraPoses,
    /// Poses of vehicles that were measured.
    VehiclePoses,
    /// Smooth motion of cameras.
    CameraMotion,
    /// Smooth motion of vehicles.
    VehicleMotion,
    /// Rear axles that roll without slip.
    Driving,
    /// Coordinates that hold what is open of the frames of bodies.
    Frame,
    /// What is nobody's knowledge and only keeps an unknown in its place.
    Convention,
}

/// What kind of statement a source makes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Nature {
    /// An image point that was measured.
    Image,
    /// A measurement or real knowledge of something else.
    Knowledge,
    /// Smoothness of motion, whose strength may be estimated.
    Motion,
    /// What holds a datum that nothing else holds.
    Datum,
    /// A regularising prior without information content.
    Convention,
}

/// An error of one standard deviation that all rows of a source may have in common.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CommonCause {
    /// There is none.
    None,
    /// The ground lies higher everywhere.
    GroundShift,
    /// Every row is off by its own standard deviation.
    OneSigma,
}

/// What follows from the source of a measurement.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Traits {
    /// Its name in files, which stays whatever it is called in a sentence.
    pub key: &'static str,
    /// What kind of statement it makes.
    pub nature: Nature,
    /// Whether its rows count in full as observations of sigma0. (Given poses count as one observation together,
    /// image points as those that are accepted.)
    pub counts_in_sigma0: bool,
    /// Whether it may hold the frame of a body.
    pub holds_frame: bool,
    /// Whether each of its rows is about one vehicle.
    pub per_vehicle: bool,
    /// The error that all of its rows may share.
    pub common_cause: CommonCause,
}

impl Source {
    /// What follows from a source.
    pub fn traits(self) -> Traits {
        use CommonCause::{GroundShift, OneSigma};
        use Nature::{Convention, Datum, Image, Knowledge, Motion};
        let of = |key, nature| Traits {
            key,
            nature,
            counts_in_sigma0: matches!(nature, Knowledge | Motion),
            holds_frame: false,
            per_vehicle: false,
            common_cause: CommonCause::None,
        };
        let of_body = |key, holds_frame, common_cause| Traits {
            holds_frame,
            per_vehicle: true,
            common_cause,
            ..of(key, Knowledge)
        };
        match self {
            Source::VehicleImages => Traits { per_vehicle: true, ..of("image points of vehicles", Image) },
            Source::TargetImages => of("image points of targets", Image),
            Source::Survey => of("survey of targets", Knowledge),
            Source::Terrain => of_body("terrain contact", true, GroundShift),
            Source::KnownHeight => of_body("known height", true, OneSigma),
            Source::KnownPoint => of_body("known points", true, OneSigma),
            Source::KnownDistance => of_body("known distances", false, OneSigma),
            Source::Calibration => of("known interior orientation", Knowledge),
            Source::Readout => of("known readout time", Knowledge),
            Source::Gnss => of_body("GNSS positions", false, CommonCause::None),
            Source::GnssKnowledge => of_body("knowledge of GNSS receivers", false, CommonCause::None),
            Source::CameraPoses => Traits { counts_in_sigma0: false, ..of("given camera poses", Knowledge) },
            Source::VehiclePoses => of_body("measured vehicle poses", true, CommonCause::None),
            Source::CameraMotion => of("motion of the camera", Motion),
            Source::VehicleMotion => Traits { per_vehicle: true, ..of("motion of vehicles", Motion) },
            Source::Driving => of_body("rolling of rear axles", false, CommonCause::None),
            Source::Frame => of("frame of the body", Datum),
            Source::Convention => of("conventions", Convention),
        }
    }

    /// Whether it says something of the unknowns that nobody chose: neither an image point, nor a datum, nor a
    /// convention.
    pub fn is_knowledge(self) -> bool {
        matches!(self.traits().nature, Nature::Knowledge | Nature::Motion)
    }

    /// Whether its rows are image points.
    pub fn is_image(self) -> bool {
        self.traits().nature == Nature::Image
    }

    /// Whether it counts where it is asked what measurements and real knowledge leave open.
    pub fn is_measured(self) -> bool {
        matches!(self.traits().nature, Nature::Image | Nature::Knowledge)
    }
}
