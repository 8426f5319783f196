//! Sparse nonlinear least squares of rigid bodies seen by observers along time.
//!
//! Minimised is
//!
//! ```text
//! cost(x) = sum over measurements of rho(|r(x) / sigma|^2) / 2
//! ```
//!
//! where `r` is a residual, `sigma` the standard deviations of its rows and `rho` a robust loss. The solver knows
//! nothing of cameras or vehicles: what is measured comes from outside, as a [`Residual`].
//!
//! # A tour
//!
//! | step | with |
//! |---|---|
//! | say where unknowns live | [`Manifold`]: numbers, points, poses |
//! | say what was measured | [`Residual`] with its [`Jacobian`], checked by [`worst_jacobian_entry`] |
//! | collect both | [`SystemBuilder`]: blocks, groups of [`Measurement`]s under a [`Loss`], and what helps to eliminate them |
//! | fix the structure | [`SystemBuilder::build`] gives a [`System`]; [`System::elimination`] tells how it is eliminated |
//! | find the minimum | [`Minimiser`], [`MinimiserOptions`]; a [`Minimum`] says why it stopped ([`Stop`]) |
//! | say how good it is | [`Covariance`]: blocks of the inverse, leverages of measurements |
//!
//! ```
//! use trackbundle_solver::nalgebra::{Vector1, Vector3};
//! use trackbundle_solver::{
//!     Covariance, Jacobian, Loss, Manifold, Measurement, Minimiser, MinimiserOptions, Residual, SystemBuilder,
//! };
//!
//! /// The distance of a point from a station that is known [m].
//! struct Distance {
//!     station: Vector3<f64>,
//!     measured_m: f64,
//! }
//!
//! impl Residual<1, 1> for Distance {
//!     const MANIFOLDS: [Manifold; 1] = [Manifold::POINT];
//!
//!     fn evaluate(&self, x: &[&[f64]; 1], jacobian: Option<&mut Jacobian<1, 1>>) -> Option<Vector1<f64>> {
//!         let arm = Vector3::from_column_slice(x[0]) - self.station;
//!         if let Some(jacobian) = jacobian {
//!             jacobian.set(0, 0, &arm.normalize().transpose());
//!         }
//!         (arm.norm() > 0.0).then(|| Vector1::new(arm.norm() - self.measured_m))
//!     }
//! }
//!
//! let mut builder = SystemBuilder::default();
//! let point = builder.add_block(Manifold::POINT, &[1.0, 1.0, 1.0], &[true; 3]);
//! let stations = [[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [0.0, 10.0, 0.0], [0.0, 0.0, 10.0]];
//! let distances = stations.map(Vector3::from).into_iter().map(|station| Measurement {
//!     residual: Distance { station, measured_m: (Vector3::new(3.0, 4.0, 2.0) - station).norm() },
//!     blocks: [point],
//!     sigma: [0.01],
//! });
//! builder.add_group("distances", Loss::Squared, distances.collect());
//! let system = builder.build();
//!
//! let minimum = Minimiser::new(&system)?.run(&system, system.start(), MinimiserOptions::default(), None);
//! assert!(minimum.stop.converged());
//! let found = system.value(&minimum.values, point);
//! assert!((found[0] - 3.0).abs() < 1e-6 && (found[1] - 4.0).abs() < 1e-6 && (found[2] - 2.0).abs() < 1e-6);
//!
//! let covariance = Covariance::new(&system, &minimum.values)?;
//! let sigma_m = covariance.block(point, point).expect("it is adjusted").diagonal().map(f64::sqrt);
//! assert!(sigma_m.max() < 0.02, "some centimetres at the most");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Vocabulary
//!
//! | word | here |
//! |---|---|
//! | block | unknowns that are perturbed together: a pose, a point, a lens |
//! | held | a component of a block that is not adjusted; a block that no measurement sees is held whole |
//! | group | measurements of one kind under one loss |
//! | whitened | divided by the standard deviations |
//! | eliminated block | one of many that share no measurement with each other, such as the points of classic bundle adjustment: eliminated one by one, before all others ([`SystemBuilder::eliminate`]; inside, a *leaf*) |
//! | moment | poses of one time: an observer and the bodies that it sees ([`TimeStep`]; inside, a *frame*) |
//! | body, shape | poses along time, and the points that go with them |
//! | image point | a measurement of a point of a body by an observer, which depends on their two poses only as they lie to each other |
//! | shared | unknowns that all moments see, such as an interior orientation ([`SystemBuilder::share`]; inside, *common*) |
//! | gauge orbit | what a motion of a body's own frame does to its poses and points: nothing that is seen changes ([`SystemBuilder::add_rigid_body`]) |
//! | joint, separate | two ways to eliminate bodies ([`Elimination`]) |
//!
//! # Limits
//!
//! * A block is perturbed by at most [`MAX_TANGENT`] = 9 numbers: every Jacobian has room for as many.
//! * Blocks that are [eliminated first](SystemBuilder::eliminate) have 1, 2, 3, 6 or 9 numbers; the elimination is
//!   compiled for each.
//! * The points of bodies that are eliminated [along time](SystemBuilder::along_time) have three numbers.
//! * An image point that sees a fourth block which is neither held nor shared makes elimination along time
//!   impossible: it falls back to a sparse one. So do poses that are held in part, and measurements that span more
//!   than five moments. The minimum is the same; [`System::elimination`] tells which it is.
//! * [`Manifold`] is a closed enum, which keeps the hot loops flat: rotations alone, or unit vectors, are not
//!   among them.
//! * The covariance is of selected blocks where poses are eliminated along time and bodies joint, of all blocks for
//!   up to 8,000 unknowns, and not to be had where blocks are eliminated first or bodies are separate.
//!
//! # The same for any number of threads
//!
//! Every sum has an order that depends on the problem alone, so that a result is the same to the last bit on one
//! thread and on many.

#![warn(unreachable_pub)]

pub mod covariance;
pub mod geometry;
pub(crate) mod linear;
pub mod loss;
pub mod manifold;
pub mod minimise;
pub mod residual;
pub mod system;

pub use covariance::{Covariance, NoCovariance, Undamped};
pub use geometry::Pose;
pub use linear::cholesky::{Singular, TooLarge};
pub use linear::dense::Spectrum;
pub use linear::ordering::Elimination;
pub use loss::{Loss, LossName};
pub use manifold::{MAX_TANGENT, Manifold};
pub use minimise::{IterationRecord, Minimiser, MinimiserOptions, Minimum, Stop};
pub use nalgebra;
pub use residual::{Jacobian, Residual, worst_jacobian_entry};
pub use system::{
    Accuracy, Arrangement, BlockId, Cost, GroupId, Measurement, System, SystemBuilder, TimeStep, Values,
};

/// The README, whose example runs as a test.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
