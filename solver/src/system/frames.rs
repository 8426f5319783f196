//! Elimination of frames: poses along time first, then one dense system of shapes.
//!
//! An image point of a body sees the pose of its observer and that of the body only as they lie to each
//! other. With `A` the motion of the body that looks like one of the observer, the unknowns of a frame
//! are taken as
//!
//! ```text
//! c   perturbation of the observer
//! y   = v + A c,   v that of the body:   what an image point sees
//! ```
//!
//! so that image points couple `y` and shape alone, with 18 numbers each, and never `c`. Everything else
//! (starting poses, motion, contact, targets) is assembled in `c` and `v` as ever and turned by
//! `T = [1 0; -A 1]`. What is left is a chain along time with the shape as its border:
//!
//! ```text
//!    frames            shape  rest
//!  [ T' H T + Hyy    |  W   |  V  ]        rest: targets and what all frames share
//!  [ W'              |  B   |     ]
//!  [ V'              |      |  C  ]
//! ```
//!
//! This module has the structure. There are two ways on from there: all bodies [together](super::together),
//! and many bodies [apart](super::apart); the one that takes fewer operations is taken.

use super::bodies::{Body, bodies, components};
use super::time_steps::{Classified, Parts, Place, Placed, Step, TimeStep};
use crate::linear::coupling::CouplingPattern;
use std::fmt;
use std::ops::Range;
use std::str::FromStr;
use std::sync::Arc;

/// Tasks that linearise steps; fixed, so that sums do not depend on the threads.
const CHUNKS: usize = 8;
/// The most steps that one measurement may span.
const MOST_BAND: usize = 4;
/// Operations beyond which a dense system of all shapes is not worth it.
const MOST_FLOPS: f64 = 5e11;

/// How bodies shall be eliminated, where poses are eliminated along time.
///
/// [`JointBodies`](crate::Elimination::JointBodies): crate::Elimination::JointBodies
/// [`SeparateBodies`](crate::Elimination::SeparateBodies): crate::Elimination::SeparateBodies
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Arrangement {
    /// What takes fewer operations.
    #[default]
    Cheapest,
    /// All poses along time, which leaves one dense system of all shapes: [`JointBodies`](crate::Elimination::JointBodies).
    Together,
    /// Each body with its shape, which leaves the observers and what all share: [`SeparateBodies`](crate::Elimination::SeparateBodies).
    Apart,
}

impl Arrangement {
    const ALL: [(&str, Arrangement); 3] = [
        ("cheapest", Arrangement::Cheapest),
        ("together", Arrangement::Together),
        ("apart", Arrangement::Apart),
    ];
}

impl fmt::Display for Arrangement {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let found = Arrangement::ALL.iter().find(|(_, arrangement)| arrangement == self);
        f.write_str(found.expect("all have names").0)
    }
}

impl FromStr for Arrangement {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        let found = Arrangement::ALL.iter().find(|(name, _)| *name == text);
        found.map(|found| found.1).ok_or_else(|| "wanted cheapest, together or apart".to_owned())
    }
}

/// The structure: which unknown is where, and which image points each body has in each step.
pub(super) struct Frames {
    pub steps: Vec<Step>,
    /// Unknowns `(c, y)` of each step.
    pub dims: Vec<(usize, usize)>,
    pub band: usize,
    /// How many steps apart poses may be of whom the covariance is wanted.
    pub reach: usize,
    pub places: Vec<Place>,
    /// The same for every scalar of the pattern.
    pub scalars: Vec<Place>,
    /// First `y` of each step, and their number at the end.
    pub y_starts: Vec<usize>,
    /// Scalars of the border: those that image points see, and all.
    pub shape: usize,
    pub border: usize,
    /// Where the coupling of shapes is kept: one for all bodies, or one for each.
    pub homes: Vec<Home>,
    /// The bodies, where they are eliminated apart.
    pub apart: Option<Vec<Body>>,
    /// Of each point of the border: its row there, and its first scalar in the pattern.
    pub points: Vec<(usize, usize)>,
    /// The steps that one task linearises.
    pub chunks: Vec<Range<usize>>,
    /// Operations of one elimination.
    pub flops: f64,
}

/// Some bodies: their rows of the border, and which of their points their poses see, in time order.
#[derive(Clone, Debug)]
pub(super) struct Home {
    pub rows: Range<usize>,
    pub coupling: Arc<CouplingPattern>,
}

/// What is known of a system along time.
pub(super) struct Declared<'a> {
    pub steps: &'a [TimeStep],
    /// The groups of image points.
    pub relative: &'a [usize],
    /// How many steps apart poses may be of whom the covariance is wanted.
    pub reach: usize,
    /// How bodies shall be eliminated.
    pub wanted: Arrangement,
}

impl Frames {
    /// `None` where the structure is another: a pose is held in part, say.
    pub(super) fn new(declared: &Declared<'_>, parts: Parts<'_>) -> Option<Frames> {
        let Declared { relative, wanted, .. } = *declared;
        let Parts { blocks, groups, position, pattern } = parts;
        let found = Classified::new(declared.steps, relative, parts)?;
        let of_block = components(&found.steps, relative, groups, &found.at_step, blocks.len());
        let mut of_position = vec![0; pattern.rows().len()];
        for block in 0..blocks.len() {
            position[block].into_iter().for_each(|p| of_position[p] = of_block[block]);
        }
        let placed = found.place(&of_block, parts)?;
        if placed.band > MOST_BAND {
            return None;
        }
        let apart = match wanted {
            Arrangement::Together => None,
            _ => bodies(&placed, pattern, &of_block, &of_position),
        };
        let mut frames = Frames::of(placed, declared.reach, parts);
        match apart {
            Some((bodies, flops)) if wanted == Arrangement::Apart || flops < frames.flops => {
                for (home, body) in bodies.iter().enumerate() {
                    for &(step, order) in &body.places {
                        frames.steps[step].bodies[order].home = home;
                    }
                }
                let rows = bodies.iter().map(|body| body.shape.clone()).collect();
                frames.apart = Some(bodies);
                frames.flops = flops;
                frames.set_homes(rows, parts);
            }
            _ if frames.flops > MOST_FLOPS => return None,
            _ => frames.set_homes(std::iter::once(0..frames.shape).collect(), parts),
        }
        Some(frames)
    }

    /// With all bodies together, their coupling not yet set.
    fn of(placed: Placed, reach: usize, parts: Parts<'_>) -> Frames {
        let Placed { steps, dims, band, places, shape, border } = placed;
        let pattern = parts.pattern;
        let scalars = places.iter().enumerate().flat_map(|(position, place)| {
            (0..pattern.range(position).len()).map(move |inner| match *place {
                Place::Chain(step, at) => Place::Chain(step, at + inner),
                Place::Border(at) => Place::Border(at + inner),
            })
        });
        let scalars = scalars.collect();
        let point = |(position, place): (usize, &Place)| match *place {
            Place::Border(at) if at < shape => Some((at, pattern.range(position).start)),
            _ => None,
        };
        let points = places.iter().enumerate().filter_map(point).collect();
        let mut y_starts = vec![0];
        dims.iter().for_each(|(_, y)| y_starts.push(y_starts[y_starts.len() - 1] + y));
        let (m, ys) = (border as f64, y_starts[y_starts.len() - 1] as f64);
        let flops = ys * (shape as f64).powi(2) + m.powi(3) / 3.0;
        let count = steps.len();
        let size = count.div_ceil(CHUNKS).max(1);
        let chunks = (0..count).step_by(size).map(|first| first..(first + size).min(count)).collect();
        let (homes, apart) = (Vec::new(), None);
        Frames {
            steps,
            dims,
            band,
            reach,
            places,
            scalars,
            y_starts,
            shape,
            border,
            homes,
            apart,
            points,
            chunks,
            flops,
        }
    }

    fn set_homes(&mut self, rows: Vec<Range<usize>>, parts: Parts<'_>) {
        let mut seen: Vec<Vec<Vec<u32>>> = vec![Vec::new(); rows.len()];
        for body in self.steps.iter().flat_map(|step| &step.bodies) {
            let of_item = |&(group, item): &(u32, u32)| {
                let point = parts.groups[group as usize].blocks(item as usize)[2];
                match self.places[parts.position[point.0]?] {
                    Place::Border(at) => Some((at - rows[body.home].start) as u32),
                    Place::Chain(..) => None,
                }
            };
            seen[body.home].push(body.items.iter().filter_map(of_item).collect());
        }
        let home = |(rows, seen): (Range<usize>, Vec<Vec<u32>>)| Home {
            coupling: Arc::new(CouplingPattern::new(rows.len(), seen)),
            rows,
        };
        self.homes = rows.into_iter().zip(seen).map(home).collect();
    }
}
