//! Why a vehicle takes no part in the adjustment.

/// Why a vehicle is left out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LeftOut {
    /// It is never seen.
    NeverSeen,
    /// It has no starting poses, and there is no terrain to find them on.
    NoTerrain,
    /// It has no starting poses, and no ray meets the terrain.
    RaysMissTerrain {
        /// How many rays there are.
        rays: usize,
    },
    /// It has no starting poses, and no frame has two of its points on the terrain.
    TooFewOnTerrain,
    /// It has no starting poses, and no frame has a position.
    NoPositions,
    /// It has no starting poses, and the cone program of its motion was not solved.
    MotionNotSolved,
    /// Too few of its points are seen in two frames or more.
    TooFewSeen {
        /// How many are.
        seen: usize,
        /// How many would do.
        needed: usize,
    },
    /// Too few of its points have rays that meet.
    TooFewIntersected {
        /// How many have.
        found: usize,
        /// How many would do.
        needed: usize,
    },
}
