//! Motion priors and their strength.
//!
//! A prior says that a body's acceleration, or its jerk, is white noise: that of a camera in the axes of the
//! world, since it is stabilised apart from its path, that of a vehicle in its own, in which a steady curve
//! has none. How strong the noise is, is estimated from
//! the data as a variance component (Foerstner, *Ein Verfahren zur Schaetzung von Varianz- und
//! Kovarianzkomponenten*, AVN 86, 1979): of the rows of a group, whitened with the present strength,
//!
//! ```text
//! factor of the variance = (sum of squares) / (rows - trace of (J H^-1 J^T))
//! ```
//!
//! is 1 where the strength is right. The trace is the mean of `z^T J H^-1 J^T z` over vectors `z` of
//! random signs (Hutchinson 1990), drawn from a fixed seed.
//!
//! Of a vehicle on the ground that is the motion along the ground and the yaw. Its height and its lean follow the
//! ground, whose errors of standard deviation `s` last for a time `tau`. They do so smoothly: a process of this standard
//! deviation that is white in its acceleration (in its jerk), and is forgotten at the rate `l = 2 / tau`, is driven by
//! noise of the strength
//!
//! ```text
//! s sqrt(4 l^3)          jerk: s sqrt(16/3 l^5)          (Matern processes of order 3/2 and 5/2)
//! ```
//!
//! So much their motion has besides: held to less, a body that leans as the contact allows makes a weak scale
//! collapse.

use super::sink::Sink;
use super::source::Source;
use crate::problem::{ContactRules, GroundKnowledge};
use crate::residuals::jerk::{AngularJerk, FourSteps, Jerk, LinearJerk};
use crate::residuals::scale_free::{Counting, PointMotion, ScaleFree, ScaleFreeFrom, ScaleFreeSeen};
use crate::residuals::smooth_motion::{Acceleration, AngularAcceleration, Steps};
use crate::residuals::twist::LinearAcceleration;
use crate::terrain::Ground;
pub use crate::trajectory::{Order, Strengths};
use nalgebra::Point3;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use trackbundle_solver::Singular;
use trackbundle_solver::minimise::Minimiser;
use trackbundle_solver::residual::Residual;
use trackbundle_solver::system::{Accuracy, BlockId, GroupId, Measurement, System, Values};

/// How strongly motion is smoothed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionPriors {
    /// That of the camera.
    pub camera: MotionPrior,
    /// That of vehicles.
    pub vehicle: MotionPrior,
}

/// The motion prior of a body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum MotionPrior {
    /// What is white noise; its strength is estimated from the data.
    Estimated(Order),
    /// Its strength is known.
    Given(Order, Strengths),
    /// There is none.
    Off,
}

impl MotionPriors {
    /// What of a vehicle's motion is white noise.
    pub fn vehicle_order(&self) -> Order {
        match self.vehicle {
            MotionPrior::Estimated(order) | MotionPrior::Given(order, _) => order,
            MotionPrior::Off => Order::Acceleration,
        }
    }

    /// Everything is estimated from the data.
    pub const ESTIMATED: MotionPriors = MotionPriors {
        camera: MotionPrior::Estimated(Order::Acceleration),
        vehicle: MotionPrior::Estimated(Order::Acceleration),
    };
    /// There are none.
    pub const OFF: MotionPriors = MotionPriors { camera: MotionPrior::Off, vehicle: MotionPrior::Off };
}

/// Strengths from which the estimation starts: a hovering drone and a car in town.
fn first_strengths(body: &Body, order: Order) -> Strengths {
    let [linear, angular] = match (body, order) {
        (Body::Camera, Order::Acceleration) => [0.3, 0.02],
        (Body::Vehicle(_), Order::Acceleration) => [1.0, 0.05],
        (Body::Camera, Order::Jerk) => [0.5, 0.05],
        (Body::Vehicle(_), Order::Jerk) => [2.0, 0.2],
    };
    Strengths { linear, angular }
}
/// An estimate stays within these factors of its start: a body at rest has no smallest strength.
const FACTOR_BOUNDS: (f64, f64) = (1e-3, 1e2);
/// Fewest rows, and least redundancy in them, from which a strength is estimated.
const LEAST_ROWS: usize = 24;
const LEAST_REDUNDANCY: f64 = 3.0;
/// Random vectors for a trace, where they are as short as the least.
const MOST_PROBES: usize = 8;
/// Fewer do where each has many numbers: so many altogether, and two at least.
const PROBED_ROWS: usize = 4096;
/// Random vectors need no better solutions.
const TRACE_ACCURACY: Accuracy = Accuracy::Share(1e-3);
/// Traces are found in so many batches. Strengths of a batch share their solutions, which adds to each
/// trace what the others correlate with it times random signs: nothing in the mean, and little at all
/// where they are those of different bodies.
const BATCHES: usize = 4;
/// A strength falls by no more than this in a step, as a logarithm, unless the plain factor does.
const MOST_DROP: f64 = 1.2;
/// The largest power of a factor that is applied.
const MOST_POWER: f64 = 3.0;

/// Whose motion.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Body {
    /// The camera's.
    Camera,
    /// That of the vehicle with this id.
    Vehicle(String),
}

/// A pose of a body.
#[derive(Clone, Copy, Debug)]
pub struct TimedPose {
    /// Its time \[s\].
    pub time_s: f64,
    /// Its block.
    pub block: BlockId,
    /// In what its motion is counted there; alike for all poses of a body.
    pub counted: Counted,
    /// The ground under it, where it is known to follow it.
    pub ground: Option<Ground>,
}

/// In what the motion of a body is counted.
#[derive(Clone, Copy, Debug)]
pub enum Counted {
    /// In metres, along the axes of the world.
    Metres,
    /// Of a camera: in distances from a point of a vehicle wherever that goes, along the axes of the world.
    FromVehicle {
        /// The pose of the vehicle.
        vehicle: BlockId,
        /// The point.
        point: BlockId,
        /// About how far away it is \[m\].
        distance_m: f64,
    },
    /// That of a point of a vehicle in distances from where the camera is held, along the axes of the body.
    FromPlace {
        /// The point.
        point: BlockId,
        /// The place of the camera.
        camera: Point3<f64>,
        /// About how far away it is \[m\].
        distance_m: f64,
    },
    /// That of a point of a vehicle in distances from the camera wherever it goes, along the axes of the body.
    FromCamera {
        /// The point.
        point: BlockId,
        /// The pose of the camera.
        camera: BlockId,
        /// About how far away it is \[m\].
        distance_m: f64,
    },
}

/// The groups of motion priors in a system.
#[derive(Default)]
pub struct Motion {
    components: Vec<Component>,
}

struct Component {
    body: Body,
    group: GroupId,
    /// The strength at first.
    first: f64,
    /// What height and lean have besides, for their motion.
    of_ground: f64,
    is_rotation: bool,
    order: Order,
    is_estimated: bool,
    /// Along which axes rows say how strong it is.
    telling: [bool; 3],
    /// Logarithm of the last factor that was asked for, and the power of it that was applied.
    last: Option<(f64, f64)>,
}

impl Component {
    /// What the strength is multiplied by.
    fn factor(&self, system: &System) -> f64 {
        let factors = system.sigma_factors(self.group).iter().zip(self.telling);
        factors.filter(|(_, tells)| *tells).map(|(factor, _)| *factor).next().unwrap_or(1.0)
    }

    fn set_factor(&self, system: &mut System, factor: f64) {
        let of_others = (factor * self.first).hypot(self.of_ground) / self.first.hypot(self.of_ground);
        let factors = self.telling.map(|tells| if tells { factor } else { of_others });
        system.set_sigma_factors(self.group, &factors);
    }

    fn is_to_be_estimated(&self, system: &System) -> bool {
        self.is_estimated && system.rows(self.group) >= LEAST_ROWS
    }

    /// Whitened rows that say how strong it is, one measurement after the other.
    fn telling_rows(&self, system: &System, values: &Values) -> Vec<Vec<f64>> {
        let telling = |rows: Vec<f64>| {
            rows.into_iter().zip(self.telling).filter(|(_, tells)| *tells).map(|(row, _)| row).collect()
        };
        system.residuals(self.group, values).into_iter().flatten().map(telling).collect()
    }

    /// The power of a factor to apply. The plain iteration closes only a share of the distance each
    /// time where the prior, not the data, rules the motion; what the last factor left over says how
    /// large that share is.
    fn power(&self, log_factor: f64) -> f64 {
        match self.last {
            Some((last, power)) if last.abs() > 1e-3 => {
                let share = (1.0 - log_factor / last) / power;
                if share > 0.0 { (1.0 / share).clamp(1.0, MOST_POWER) } else { MOST_POWER }
            }
            _ => 1.0,
        }
    }
}

/// The strength of a motion prior at the end.
#[derive(Clone, Debug, PartialEq)]
pub struct BodyStrength {
    /// Whose.
    pub body: Body,
    /// What is white noise.
    pub order: Order,
    /// How strong.
    pub strength: Strengths,
    /// Whether it was estimated.
    pub is_estimated: bool,
}

fn add_accelerations(
    sink: &mut impl Sink,
    source: Source,
    poses: &[TimedPose],
    [linear, angular]: [[f64; 3]; 2],
) -> [GroupId; 2] {
    let (mut positions, mut rotations) = (Positions::default(), Vec::new());
    for three in poses.windows(3) {
        let [a, b, c] = [&three[0], &three[1], &three[2]];
        let steps = Steps { first_s: b.time_s - a.time_s, second_s: c.time_s - b.time_s };
        let (blocks, root) = ([a.block, b.block, c.block], steps.mean_s().sqrt());
        // The motion of poses that are held says nothing.
        if !sink.decides(&blocks) {
            continue;
        }
        let motions = (Acceleration(steps), LinearAcceleration(steps));
        let [one, two, three] = blocks;
        let with_one = |x| [one, two, three, x];
        let with_two = |x, y| [one, two, three, x, y];
        positions.add(
            motions,
            b.counted,
            (blocks, &with_one, &with_two),
            linear.map(|strength| strength / root),
        );
        let sigma = angular.map(|strength| strength / root);
        rotations.push(Measurement { residual: AngularAcceleration(steps), blocks, sigma });
    }
    [positions.into_group(sink, source), sink.squares(source, ATTITUDE, rotations)]
}

fn add_jerks(
    sink: &mut impl Sink,
    source: Source,
    poses: &[TimedPose],
    [linear, angular]: [[f64; 3]; 2],
) -> [GroupId; 2] {
    let (mut positions, mut rotations) = (Positions::default(), Vec::new());
    for four in poses.windows(4) {
        let step = |at: usize| four[at + 1].time_s - four[at].time_s;
        let steps = FourSteps { first_s: step(0), second_s: step(1), third_s: step(2) };
        let blocks = [0, 1, 2, 3].map(|at| four[at].block);
        if !sink.decides(&blocks) {
            continue;
        }
        let root = steps.mean_s().sqrt();
        let [a, b, c, d] = blocks;
        let motions = (Jerk(steps), LinearJerk(steps));
        let with_one = |x| [a, b, c, d, x];
        let with_two = |x, y| [a, b, c, d, x, y];
        positions.add(
            motions,
            four[1].counted,
            (blocks, &with_one, &with_two),
            linear.map(|strength| strength / root),
        );
        let sigma = angular.map(|strength| strength / root);
        rotations.push(Measurement { residual: AngularJerk(steps), blocks, sigma });
    }
    [positions.into_group(sink, source), sink.squares(source, ATTITUDE, rotations)]
}

/// How strong the motion of height and of lean is of a body that follows the ground as the contact allows, and where
/// that rises and falls.
fn strengths_of_contact(
    (ground, lasts_s): (&GroundKnowledge, f64),
    order: Order,
    poses: &[TimedPose],
) -> [f64; 2] {
    let [Some(first), Some(last)] = [poses.first(), poses.last()] else { return [0.0; 2] };
    let step_s = (last.time_s - first.time_s) / (poses.len() - 1).max(1) as f64;
    let lasts_s = lasts_s.max(step_s);
    if lasts_s <= 0.0 {
        return [0.0; 2];
    }
    let rate = 2.0 / lasts_s;
    let by_sigma = match order {
        Order::Acceleration => (4.0 * rate.powi(3)).sqrt(),
        Order::Jerk => (16.0 / 3.0 * rate.powi(5)).sqrt(),
    };
    let of_contact = [ground.sigma_m, ground.tilt_sigma_rad.min(ContactRules::DEFAULT.most_lean_rad)];
    let of_relief = strengths_of_relief(order, poses);
    [0, 1].map(|part| (of_contact[part] * by_sigma).hypot(of_relief[part]))
}

/// How strong the motion of height and of lean is of what follows the ground exactly: the root mean square of what it asks
/// for.
fn strengths_of_relief(order: Order, poses: &[TimedPose]) -> [f64; 2] {
    let (mut sums, mut count) = ([0.0; 2], 0.0);
    let among = match order {
        Order::Acceleration => 3,
        Order::Jerk => 4,
    };
    for some in poses.windows(among) {
        let steps: Vec<f64> = some.windows(2).map(|two| two[1].time_s - two[0].time_s).collect();
        let rate = |two: &[TimedPose]| {
            let (before, after, step_s) = (two[0].ground?, two[1].ground?, two[1].time_s - two[0].time_s);
            Some(
                [
                    after.slope.x - before.slope.x,
                    after.slope.y - before.slope.y,
                    after.height_m - before.height_m,
                ]
                .map(|change| change / step_s),
            )
        };
        let Some(rates) = some.windows(2).map(rate).collect::<Option<Vec<_>>>() else { continue };
        let (weights, mean_s) = match steps[..] {
            [first_s, second_s, third_s] => {
                let steps = FourSteps { first_s, second_s, third_s };
                (steps.weights().to_vec(), steps.mean_s())
            }
            _ => {
                let mean_s = Steps { first_s: steps[0], second_s: steps[1] }.mean_s();
                (vec![-1.0 / mean_s, 1.0 / mean_s], mean_s)
            }
        };
        let asked =
            |axis: usize| rates.iter().zip(&weights).map(|(rate, weight)| weight * rate[axis]).sum::<f64>();
        sums[0] += asked(2).powi(2) * mean_s;
        sums[1] += 0.5 * (asked(0).powi(2) + asked(1).powi(2)) * mean_s;
        count += 1.0;
    }
    sums.map(|sum| if count > 0.0 { (sum / count).sqrt() } else { 0.0 })
}

/// Motion of positions, by how it is counted: in the world `A`, in the axes of the body `B`, over `N` poses, over these
/// and a point (`P`), and over these and one of what it is counted from (`L`). All rows of a body are counted alike.
struct Positions<A, B, const N: usize, const P: usize, const L: usize> {
    in_metres: Vec<Measurement<A, 3, N>>,
    from_vehicle: Vec<Measurement<ScaleFreeFrom<A>, 3, L>>,
    from_place: Vec<Measurement<ScaleFree<PointMotion<B>>, 3, P>>,
    from_camera: Vec<Measurement<ScaleFreeSeen<PointMotion<B>>, 3, L>>,
}

impl<A, B, const N: usize, const P: usize, const L: usize> Default for Positions<A, B, N, P, L> {
    fn default() -> Self {
        Positions {
            in_metres: Vec::new(),
            from_vehicle: Vec::new(),
            from_place: Vec::new(),
            from_camera: Vec::new(),
        }
    }
}

/// The poses of a motion; these and one more block; these and two more.
type MotionBlocks<'a, const N: usize, const P: usize, const L: usize> =
    ([BlockId; N], &'a dyn Fn(BlockId) -> [BlockId; P], &'a dyn Fn(BlockId, BlockId) -> [BlockId; L]);

impl<A, B, const N: usize, const P: usize, const L: usize> Positions<A, B, N, P, L>
where
    A: Residual<3, N> + 'static,
    B: Residual<3, N> + 'static,
    PointMotion<B>: Residual<3, P>,
    ScaleFreeFrom<A>: Residual<3, L>,
    ScaleFreeSeen<PointMotion<B>>: Residual<3, L>,
{
    fn add(
        &mut self,
        (in_world, in_body): (A, B),
        counted: Counted,
        (blocks, with_one, with_two): MotionBlocks<'_, N, P, L>,
        sigma: [f64; 3],
    ) {
        // The second pose is where the motion is.
        let counting = |distance_m| Counting { rows: 3, pose: 1, distance_m };
        match counted {
            Counted::Metres => self.in_metres.push(Measurement { residual: in_world, blocks, sigma }),
            Counted::FromVehicle { vehicle, point, distance_m } => {
                let residual = ScaleFreeFrom { of: in_world, counting: counting(distance_m) };
                self.from_vehicle.push(Measurement { residual, blocks: with_two(vehicle, point), sigma });
            }
            Counted::FromPlace { point, camera, distance_m } => {
                let (of, counting) = (PointMotion(in_body), counting(distance_m));
                let residual = ScaleFree { of, counting, camera };
                self.from_place.push(Measurement { residual, blocks: with_one(point), sigma });
            }
            Counted::FromCamera { point, camera, distance_m } => {
                let residual = ScaleFreeSeen { of: PointMotion(in_body), counting: counting(distance_m) };
                self.from_camera.push(Measurement { residual, blocks: with_two(point, camera), sigma });
            }
        }
    }

    fn into_group(self, sink: &mut impl Sink, source: Source) -> GroupId {
        if !self.from_vehicle.is_empty() {
            sink.squares(source, POSITION, self.from_vehicle)
        } else if !self.from_place.is_empty() {
            sink.squares(source, POSITION, self.from_place)
        } else if !self.from_camera.is_empty() {
            sink.squares(source, POSITION, self.from_camera)
        } else {
            sink.squares(source, POSITION, self.in_metres)
        }
    }
}

/// Names of the groups.
const POSITION: &str = "smooth position";
const ATTITUDE: &str = "smooth attitude";

impl Motion {
    /// Adds the prior of a body with these poses in time order.
    ///
    /// Of a vehicle on the ground only its motion along the ground and its yaw say how strong motion is. Its height
    /// and its lean are held by the contact, whose rows observe nothing: they say that a height is zero that is not,
    /// and would make all motion look weaker than it is.
    pub fn add(
        &mut self,
        sink: &mut impl Sink,
        body: Body,
        poses: &[TimedPose],
        prior: MotionPrior,
        contact: Option<(&GroundKnowledge, f64)>,
    ) {
        let (order, first, is_estimated) = match prior {
            MotionPrior::Off => return,
            MotionPrior::Given(order, strengths) => (order, strengths, false),
            MotionPrior::Estimated(order) => (order, first_strengths(&body, order), true),
        };
        let source = match body {
            Body::Camera => Source::CameraMotion,
            Body::Vehicle(_) => Source::VehicleMotion,
        };
        let of_ground = contact.map_or([0.0; 2], |contact| strengths_of_contact(contact, order, poses));
        let telling = match contact {
            None => [[true; 3]; 2],
            Some(_) => [[true, true, false], [false, false, true]],
        };
        let first = [first.linear, first.angular];
        let strengths = [0, 1].map(|part| {
            telling[part].map(|tells| if tells { first[part] } else { first[part].hypot(of_ground[part]) })
        });
        let groups = match order {
            Order::Acceleration => add_accelerations(sink, source, poses, strengths),
            Order::Jerk => add_jerks(sink, source, poses, strengths),
        };
        for part in [0, 1] {
            self.components.push(Component {
                body: body.clone(),
                group: groups[part],
                first: first[part],
                of_ground: of_ground[part],
                is_rotation: part == 1,
                order,
                is_estimated,
                telling: telling[part],
                last: None,
            });
        }
    }

    /// Whether any strength is estimated.
    pub fn is_estimated(&self) -> bool {
        self.components.iter().any(|c| c.is_estimated)
    }

    /// The groups whose strength is estimated, whose motion each is, and which rows say how strong.
    pub fn estimated_groups(&self) -> Vec<(&Body, GroupId, [bool; 3])> {
        let estimated = self.components.iter().filter(|c| c.is_estimated);
        estimated.map(|c| (&c.body, c.group, c.telling)).collect()
    }

    /// The present strengths.
    pub fn strengths(&self, system: &System) -> Vec<BodyStrength> {
        let of = |c: &Component| c.first * c.factor(system);
        self.components
            .chunks_exact(2)
            .filter(|pair| pair.iter().any(|c| system.rows(c.group) > 0))
            .map(|pair| BodyStrength {
                body: pair[0].body.clone(),
                order: pair[0].order,
                strength: Strengths { linear: of(&pair[0]), angular: of(&pair[1]) },
                is_estimated: pair[0].is_estimated,
            })
            .collect()
    }

    /// Takes over the strengths of another system of the same problem.
    pub fn copy(&self, system: &mut System, other: &Motion, other_system: &System) {
        for (component, other) in self.components.iter().zip(&other.components) {
            debug_assert_eq!((component.is_rotation, &component.body), (other.is_rotation, &other.body));
            component.set_factor(system, other.factor(other_system));
        }
    }

    /// Sets the strengths that are to be estimated to what true `values` scatter: the mean square of the rows, and
    /// twice that of each with the next. (Where acceleration is white in continuous time, second differences of
    /// positions have two thirds of its variance, and a sixth in common with their neighbours. What an adjustment
    /// sees of them is slow, and has all of it.)
    pub fn set_by_truth(&self, system: &mut System, values: &Values) {
        for component in &self.components {
            if !component.is_to_be_estimated(system) {
                continue;
            }
            let rows = component.telling_rows(system, values);
            let count = rows.iter().map(Vec::len).sum::<usize>() as f64;
            let square: f64 = rows.iter().flatten().map(|v| v * v).sum();
            let product = |pair: &[Vec<f64>]| pair[0].iter().zip(&pair[1]).map(|(a, b)| a * b).sum::<f64>();
            let with_next: f64 = rows.windows(2).map(product).sum();
            let variance = ((square + 2.0 * with_next) / count).max(0.0);
            let factor = component.factor(system) * variance.sqrt();
            component.set_factor(system, factor.clamp(FACTOR_BOUNDS.0, FACTOR_BOUNDS.1));
        }
    }

    /// One step of the estimation at `values`; returns the largest factor by which a strength changes.
    pub fn estimate(
        &mut self,
        system: &mut System,
        minimiser: &mut Minimiser,
        values: &Values,
    ) -> Result<f64, Singular> {
        let mut estimated: Vec<&mut Component> =
            self.components.iter_mut().filter(|c| c.is_to_be_estimated(system)).collect();
        if estimated.is_empty() {
            return Ok(1.0);
        }
        let (normal, factors) = minimiser.factors(system, values)?;
        let n = system.size();
        let fewest = estimated.iter().map(|c| system.rows(c.group)).min().unwrap_or(0);
        let probes = (PROBED_ROWS / fewest.max(1)).clamp(2, MOST_PROBES);
        let mut rng = ChaCha8Rng::seed_from_u64(0);
        let mut signs_of = |component: &Component| -> Vec<Vec<f64>> {
            let mut sign = |row: usize| {
                let sign = if rng.random::<bool>() { 1.0 } else { -1.0 };
                if component.telling[row % 3] { sign } else { 0.0 }
            };
            let rows = system.rows(component.group);
            (0..probes).map(|_| (0..rows).map(&mut sign).collect()).collect()
        };
        let signs: Vec<Vec<Vec<f64>>> = estimated.iter().map(|c| signs_of(c)).collect();
        let place = |component: usize, probe: usize| (component % BATCHES * probes + probe) * n;
        let mut solutions = vec![0.0; n * probes * BATCHES.min(estimated.len())];
        for (at, (component, signs)) in estimated.iter().zip(&signs).enumerate() {
            for (probe, signs) in signs.iter().enumerate() {
                let product = system.transposed_product(component.group, normal, signs);
                let sum = &mut solutions[place(at, probe)..][..n];
                sum.iter_mut().zip(product).for_each(|(sum, p)| *sum += p);
            }
        }
        factors.solve(system, normal, TRACE_ACCURACY, &mut solutions);

        let mut largest = 1.0_f64;
        for (at, component) in estimated.iter_mut().enumerate() {
            let trace = (0..probes)
                .map(|probe| {
                    let product = system.transposed_product(component.group, normal, &signs[at][probe]);
                    product.iter().zip(&solutions[place(at, probe)..]).map(|(a, b)| a * b).sum::<f64>()
                })
                .sum::<f64>()
                / probes as f64;
            let telling = component.telling_rows(system, values);
            let redundancy = telling.iter().map(Vec::len).sum::<usize>() as f64 - trace;
            let squares: f64 = telling.iter().flatten().map(|v| v * v).sum();
            if redundancy < LEAST_REDUNDANCY {
                continue;
            }
            let log_factor = 0.5 * (squares / redundancy).ln();
            let power = component.power(log_factor);
            component.last = Some((log_factor, power));
            let before = component.factor(system);
            // Far below the data nothing would be left to tell the strength from.
            let step = (power * log_factor).max(log_factor.min(-MOST_DROP));
            let after = (before * step.exp()).clamp(FACTOR_BOUNDS.0, FACTOR_BOUNDS.1);
            component.set_factor(system, after);
            largest = largest.max(after / before).max(before / after);
        }
        Ok(largest)
    }
}

#[cfg(test)]
mod tests {
    use super::super::sink::SystemSink;
    use super::*;
    use crate::geometry::rotation::exp;
    use crate::geometry::{Pose, pose};
    use crate::residuals::pose_prior::PosePrior;
    use nalgebra::{Matrix2, Rotation3, Vector2, Vector3};
    use trackbundle_solver::manifold::{Manifold, write_pose};
    use trackbundle_solver::minimise::MinimiserOptions;

    const STEP_S: f64 = 1.0 / 30.0;
    const SIGMAS: [f64; 6] = [0.002, 0.002, 0.002, 2e-4, 2e-4, 2e-4];

    /// Gaussian enough: the sum of twelve uniform numbers.
    fn normal(rng: &mut ChaCha8Rng) -> f64 {
        (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0
    }

    fn normal3(rng: &mut ChaCha8Rng) -> Vector3<f64> {
        Vector3::from_fn(|_, _| normal(rng))
    }

    /// Poses whose second differences are white noise of this strength, with measurement noise.
    fn measured_poses(strength: Strengths, count: usize) -> Vec<Pose> {
        let rng = &mut ChaCha8Rng::seed_from_u64(3);
        let root = STEP_S.sqrt();
        let (mut position, mut velocity) = (Vector3::zeros(), Vector3::new(5.0, 0.0, 0.0));
        let (mut rotation, mut rate) = (exp(&Vector3::zeros()), Vector3::new(0.0, 0.0, 0.1));
        let mut poses = Vec::new();
        for _ in 0..count {
            let noise = normal3(rng) * SIGMAS[0];
            let mut measured = pose((position + noise).into(), [1.0, 0.0, 0.0, 0.0]);
            measured.rotation = rotation * exp(&(normal3(rng) * SIGMAS[3]));
            poses.push(measured);
            position += velocity * STEP_S;
            rotation *= exp(&(rate * STEP_S));
            velocity += normal3(rng) * (strength.linear / root * STEP_S);
            rate += normal3(rng) * (strength.angular / root * STEP_S);
        }
        poses
    }

    /// Over waves of height `A` and number `k` a body at `v` is asked for `A (k v)^2` at their tops, and for `k` times that
    /// of its slope; for `k v` times more a second.
    #[test]
    fn what_the_ground_asks_for_is_its_bend_along_the_way() {
        let (height_m, number, speed, step_s) = (0.3_f64, 0.4_f64, 8.0, 0.05);
        let mut sink = SystemSink::default();
        let block = sink.builder.add_block(Manifold::Pose, &write_pose(&Pose::identity()), &[true; 6]);
        let pose = |at: usize| {
            let x = speed * step_s * at as f64;
            let ground = Ground {
                height_m: height_m * (number * x).sin(),
                slope: Vector2::new(height_m * number * (number * x).cos(), 0.0),
                bend_per_m: Matrix2::zeros(),
            };
            TimedPose { time_s: step_s * at as f64, block, counted: Counted::Metres, ground: Some(ground) }
        };
        let poses: Vec<TimedPose> = (0..2000).map(pose).collect();
        let rate = number * speed;
        for (order, power) in [(Order::Acceleration, 2), (Order::Jerk, 3)] {
            let rms = height_m * rate.powi(power) / 2_f64.sqrt() * step_s.sqrt();
            let [height, lean] = strengths_of_relief(order, &poses);
            // Of a slope along one of two axes.
            assert!((height / rms - 1.0).abs() < 0.02, "{order:?}: {height} {rms}");
            assert!((lean / (rms * number / 2_f64.sqrt()) - 1.0).abs() < 0.02, "{order:?}: {lean}");
        }
        let unknown: Vec<TimedPose> = poses.iter().map(|pose| TimedPose { ground: None, ..*pose }).collect();
        assert_eq!(strengths_of_relief(Order::Acceleration, &unknown), [0.0; 2]);
    }

    #[test]
    fn the_strength_of_simulated_motion_is_found() {
        for strength in [Strengths { linear: 0.2, angular: 0.3 }, Strengths { linear: 3.0, angular: 0.01 }] {
            let measured = measured_poses(strength, 400);
            let mut sink = SystemSink::default();
            let blocks: Vec<BlockId> = measured
                .iter()
                .map(|pose| sink.builder.add_block(Manifold::Pose, &write_pose(pose), &[true; 6]))
                .collect();
            let rows = measured.iter().zip(&blocks).map(|(start, block)| Measurement {
                residual: PosePrior { start: *start, axes: Rotation3::identity() },
                blocks: [*block],
                sigma: SIGMAS,
            });
            sink.squares(Source::CameraPoses, "poses", rows.collect());
            let timed = |(at, block): (usize, &BlockId)| TimedPose {
                time_s: at as f64 * STEP_S,
                block: *block,
                counted: Counted::Metres,
                ground: None,
            };
            let timed: Vec<TimedPose> = blocks.iter().enumerate().map(timed).collect();
            let mut motion = Motion::default();
            motion.add(&mut sink, Body::Camera, &timed, MotionPrior::Estimated(Order::Acceleration), None);
            let mut system = sink.builder.build();
            let mut minimiser = Minimiser::new(&system).unwrap();
            let mut values = system.start().clone();
            for _ in 0..8 {
                values = minimiser.run(&system, &values, MinimiserOptions::default(), None).values;
                if motion.estimate(&mut system, &mut minimiser, &values).unwrap() < 1.02 {
                    break;
                }
            }
            let found = motion.strengths(&system)[0].strength;
            let ratios = [found.linear / strength.linear, found.angular / strength.angular];
            // 1,200 rows say a standard deviation to about 1/sqrt(2 * 1200 * share of the prior).
            assert!(ratios.iter().all(|ratio| (0.85..1.18).contains(ratio)), "{strength:?}: {ratios:?}");
        }
    }
}
