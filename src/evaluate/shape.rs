//! A shape against a scan of its vehicle, and against the truth where a problem is simulated.
//!
//! The points come onto the scan by the registration that is asked for; then each has its distance to
//! the nearest point of the scan, to the local plane there, and to the mesh where the scan is one.

use super::EvaluateOptions;
use crate::cloud::mesh::{Enclosure, MeshIndex};
use crate::cloud::plane::{NEIGHBOURS, plane_distances};
use crate::cloud::register::{RegisterOptions, register_from_afar};
use crate::cloud::statistics::precision_weight;
use crate::cloud::truth::{FittedErrors, PointErrors, point_errors};
use crate::cloud::{CloudIndex, DistanceStatistics, distances};
use crate::files::ResultPoint;
use crate::geometry::Pose;
use crate::reference::{Reference, Scan, TrueShape};
use nalgebra::Point3;

/// How a shape comes onto its scan.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Registering {
    /// As both stand: the scan is in the vehicle frame.
    None,
    /// By the matrix of `reference/<vehicle>.matrix.txt`.
    Given,
    /// By iterated closest points, from that matrix or, without it, from the vehicle frame.
    #[default]
    Icp,
}

impl Registering {
    /// Its name in options and reports.
    pub fn name(self) -> &'static str {
        match self {
            Registering::None => "none",
            Registering::Given => "given",
            Registering::Icp => "icp",
        }
    }
}

/// What else separates a shape from a scan than the standard deviations of its points: noise and spacing of the
/// scan \[m\].
pub const SCAN_SIGMA_M: f64 = 0.02;

/// Points farther from the scan than this are told apart: it may not reach there \[m\].
pub const BEYOND_M: f64 = 0.2;

/// A point of a shape against the scan.
#[derive(Clone, Debug, PartialEq)]
pub struct ComparedPoint {
    /// Its id.
    pub point: String,
    /// Its place in the vehicle frame \[m\].
    pub position: Point3<f64>,
    /// Standard deviation per axis of the vehicle frame \[m\].
    pub axis_sigmas_m: [Option<f64>; 3],
    /// Its place among the points of the scan \[m\].
    pub in_scan: Point3<f64>,
    /// Its standard deviation in space, the root of the sum of squares of its axes \[m\].
    pub sigma_m: Option<f64>,
    /// Distance to the nearest point of the scan \[m\].
    pub nearest_m: f64,
    /// Distance to the local plane of the scan \[m\].
    pub plane_m: f64,
    /// Distance to the mesh, positive outside where the mesh has an outside \[m\].
    pub mesh_m: Option<f64>,
    /// How far it is from the truth as it stands, after a rigid and after a similarity fit \[m\].
    pub truth_m: [Option<f64>; 3],
}

/// How the registration went.
#[derive(Clone, Debug, PartialEq)]
pub struct Registered {
    /// What was asked for.
    pub how: Registering,
    /// The motion that was applied to the points.
    pub scan_from_vehicle: Pose,
    /// How far that moved the middle of the shape \[m\], from where it stood at the start.
    pub moved_m: f64,
    /// How far it turned the shape \[rad\].
    pub turned_rad: f64,
    /// Of iterated closest points: share of the points that belong to the scan, and whether they settled.
    pub overlap: Option<(f64, bool)>,
    /// How many of the six directions the clouds do not determine.
    pub undetermined: usize,
}

/// Point to point errors against the truth, in a few numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TruthStatistics {
    /// As they stand.
    pub raw: DistanceStatistics,
    /// After a rigid fit.
    pub rigid: Option<DistanceStatistics>,
    /// After a similarity fit.
    pub similarity: Option<DistanceStatistics>,
    /// The scale of that.
    pub scale: Option<f64>,
}

impl TruthStatistics {
    /// What was left after each fit, by its name, and the scale where it was free.
    pub fn fits(&self) -> impl Iterator<Item = (&'static str, &DistanceStatistics, Option<f64>)> {
        let fits = [
            ("none", Some(&self.raw), None),
            ("rigid", self.rigid.as_ref(), None),
            ("similarity", self.similarity.as_ref(), self.scale),
        ];
        fits.into_iter().filter_map(|(name, found, scale)| Some((name, found?, scale)))
    }
}

/// A shape held against its scan.
#[derive(Clone, Debug, PartialEq)]
pub struct ShapeComparison {
    /// The vehicle.
    pub vehicle: String,
    /// The file of the scan.
    pub file: String,
    /// The points of the scan \[m\].
    pub scan: Vec<Point3<f64>>,
    /// How the points came onto it.
    pub registered: Registered,
    /// The points.
    pub points: Vec<ComparedPoint>,
    /// For each point of the scan the distance to the nearest point of the shape \[m\].
    pub from_scan_m: Vec<f64>,
    /// Distances to the nearest point of the scan.
    pub to_scan: DistanceStatistics,
    /// The same weighted by the standard deviations of the points, where they are known.
    pub weighted: Option<DistanceStatistics>,
    /// The same of points whose standard deviation is at most `limit_m`.
    pub limited: Option<DistanceStatistics>,
    /// That limit \[m\].
    pub limit_m: f64,
    /// Distances to the local plane.
    pub to_plane: DistanceStatistics,
    /// Distances to the mesh.
    pub to_mesh: Option<DistanceStatistics>,
    /// Distances from the scan to the shape.
    pub from_scan: DistanceStatistics,
    /// Against the truth.
    pub truth: Option<TruthStatistics>,
    /// What else is to be said.
    pub notes: Vec<String>,
}

impl ShapeComparison {
    /// How many points are farther than [`BEYOND_M`] from the scan.
    pub fn beyond(&self) -> usize {
        self.points.iter().filter(|point| point.nearest_m > BEYOND_M).count()
    }

    /// The registration in words.
    pub fn registration_told(&self) -> String {
        let Registered { how, moved_m, turned_rad, overlap, .. } = &self.registered;
        match how {
            Registering::None => "none, as both stand".to_owned(),
            Registering::Given => "by the given matrix".to_owned(),
            Registering::Icp => format!(
                "by iterated closest points, which moved the points by {:.1} cm and {:.2} deg (overlap {:.0} %{})",
                100.0 * moved_m,
                turned_rad.to_degrees(),
                100.0 * overlap.map_or(0.0, |(share, _)| share),
                if overlap.is_some_and(|(_, settled)| settled) { "" } else { "; it did not settle" }
            ),
        }
    }

    /// All statistics, with what they are of.
    pub fn statistics(&self) -> Vec<(String, &DistanceStatistics)> {
        let limited = format!("... with a standard deviation of at most {:.0} cm", 100.0 * self.limit_m);
        let all = [
            ("points to scan (nearest point)".to_owned(), Some(&self.to_scan)),
            ("... weighted by their standard deviations".to_owned(), self.weighted.as_ref()),
            (limited, self.limited.as_ref()),
            ("points to local plane of the scan".to_owned(), Some(&self.to_plane)),
            ("points to mesh".to_owned(), self.to_mesh.as_ref()),
            ("scan to points (nearest point)".to_owned(), Some(&self.from_scan)),
        ];
        all.into_iter().filter_map(|(name, found)| Some((name, found?))).collect()
    }
}

/// Compares the shape of a vehicle with its scan; or says why not.
pub fn compare_shape(
    vehicle: &str,
    points: &[ResultPoint],
    reference: &Reference,
    truth: Option<&TrueShape>,
    options: &EvaluateOptions,
) -> Result<ShapeComparison, String> {
    let limit_m = options.sigma_limit_m;
    let of = |(id, _): &&(String, Scan)| id == vehicle;
    let Some((_, scan)) = reference.scans.iter().find(of) else {
        return Err(format!(
            "there is no scan of it (reference/{vehicle}.ply, .las, .laz, .e57, .pcd or .xyz)"
        ));
    };
    if points.is_empty() {
        return Err("the result has no shape of it (vehicle_points.csv)".to_owned());
    }
    let given = reference.matrices.iter().find(|(id, _)| id == vehicle).map(|(_, matrix)| matrix.inverse());
    let places: Vec<Point3<f64>> = points.iter().map(|p| p.position).collect();
    let index = CloudIndex::new(scan.points.clone()).map_err(|error| format!("{}: {error}", scan.file))?;
    let (registered, mut notes) = registered(vehicle, &places, &index, given, options.registering)?;
    let in_scan: Vec<Point3<f64>> = places.iter().map(|p| registered.scan_from_vehicle * p).collect();
    let shape = CloudIndex::new(in_scan.clone()).map_err(|error| format!("the shape: {error}"))?;

    let nearest: Vec<f64> = distances(&in_scan, &index).iter().map(|near| near.distance_m).collect();
    let planes: Vec<f64> =
        plane_distances(&in_scan, &index, NEIGHBOURS).iter().map(|found| found.distance_m).collect();
    let mesh = mesh_distances(scan, &in_scan, &mut notes);
    let from_scan_m: Vec<f64> = distances(&scan.points, &shape).iter().map(|near| near.distance_m).collect();
    let sigma = |p: &ResultPoint| {
        let [x, y, z] = p.sigma_m;
        Some((x?.powi(2) + y?.powi(2) + z?.powi(2)).sqrt())
    };
    let sigmas: Vec<Option<f64>> = points.iter().map(sigma).collect();
    let weights: Vec<f64> =
        sigmas.iter().map(|s| s.map_or(0.0, |s| precision_weight(SCAN_SIGMA_M, s))).collect();
    let all = |values: &[f64]| DistanceStatistics::of(values).ok_or("nothing can be compared".to_owned());
    let truth = truth.map(|truth| TruthErrors::of(points, truth));
    let compared = |at: usize| ComparedPoint {
        point: points[at].point.clone(),
        position: places[at],
        axis_sigmas_m: points[at].sigma_m,
        in_scan: in_scan[at],
        sigma_m: sigmas[at],
        nearest_m: nearest[at],
        plane_m: planes[at],
        mesh_m: mesh.as_ref().map(|mesh| mesh[at]),
        truth_m: truth.as_ref().map_or([None; 3], |truth| truth.of_point(at)),
    };
    let mut found = ShapeComparison {
        vehicle: vehicle.to_owned(),
        file: scan.file.clone(),
        scan: scan.points.clone(),
        points: (0..points.len()).map(compared).collect(),
        to_scan: all(&nearest)?,
        weighted: DistanceStatistics::weighted(&nearest, &weights),
        limited: DistanceStatistics::limited(&nearest, &sigmas, limit_m),
        limit_m,
        to_plane: all(&planes)?,
        to_mesh: mesh.as_deref().and_then(DistanceStatistics::of),
        from_scan: all(&from_scan_m)?,
        from_scan_m,
        truth: truth.as_ref().and_then(TruthErrors::statistics),
        registered,
        notes,
    };
    let beyond = found.beyond();
    if beyond > 0 {
        found.notes.push(format!(
            "{beyond} of {} points are farther than {:.0} cm from any point of the scan: it does not reach there, or they are \
             wrong. They count in all numbers.",
            found.points.len(),
            100.0 * BEYOND_M
        ));
    }
    Ok(found)
}

fn registered(
    vehicle: &str,
    places: &[Point3<f64>],
    index: &CloudIndex,
    given: Option<Pose>,
    how: Registering,
) -> Result<(Registered, Vec<String>), String> {
    let still = |scan_from_vehicle| Registered {
        how,
        scan_from_vehicle,
        moved_m: 0.0,
        turned_rad: 0.0,
        overlap: None,
        undetermined: 0,
    };
    match how {
        Registering::None => Ok((still(Pose::identity()), Vec::new())),
        Registering::Given => {
            let given = given.ok_or_else(|| format!("there is no reference/{vehicle}.matrix.txt"))?;
            Ok((still(given), Vec::new()))
        }
        Registering::Icp => {
            let start = given.unwrap_or_else(Pose::identity);
            let found = register_from_afar(places, index, &start, &RegisterOptions::default()).map_err(|error| {
                format!("its shape does not come onto the scan: {error} (a start can be given: reference/{vehicle}.matrix.txt)")
            })?;
            let motion = found.fixed_from_moving;
            let count = places.len() as f64;
            let middle =
                Point3::from(places.iter().map(|p| p.coords).sum::<nalgebra::Vector3<f64>>() / count);
            let mut notes = Vec::new();
            if !found.undetermined.is_empty() {
                notes.push(format!(
                    "The clouds do not determine {} of the six directions of the registration: there it kept the start.",
                    found.undetermined.len()
                ));
            }
            let registered = Registered {
                how,
                scan_from_vehicle: motion,
                moved_m: (motion * middle - start * middle).norm(),
                turned_rad: (motion * start.inverse()).rotation.angle(),
                overlap: Some((found.overlap, found.is_converged)),
                undetermined: found.undetermined.len(),
            };
            Ok((registered, notes))
        }
    }
}

/// Distances to the surface of a scan that is a mesh.
fn mesh_distances(scan: &Scan, in_scan: &[Point3<f64>], notes: &mut Vec<String>) -> Option<Vec<f64>> {
    if scan.triangles.is_empty() {
        return None;
    }
    match MeshIndex::new(&scan.points, &scan.triangles) {
        Ok(mesh) => {
            if !matches!(mesh.enclosure(), Enclosure::Closed) {
                notes.push(
                    "The mesh does not enclose a body: signs of the distances to it mean little.".to_owned(),
                );
            }
            Some(mesh.distances(in_scan).iter().map(|found| found.distance_m).collect())
        }
        Err(error) => {
            notes.push(format!("The mesh of {} cannot be used: {error}.", scan.file));
            None
        }
    }
}

/// The errors of those points whose truth is known.
struct TruthErrors {
    /// Place among them of each point.
    places: Vec<Option<usize>>,
    errors: PointErrors,
}

impl TruthErrors {
    fn of(points: &[ResultPoint], truth: &TrueShape) -> Self {
        let (mut ours, mut theirs) = (Vec::new(), Vec::new());
        let mut place = |p: &ResultPoint| {
            let (_, true_position) = truth.iter().find(|(id, _)| *id == p.point)?;
            ours.push(p.position);
            theirs.push(*true_position);
            Some(ours.len() - 1)
        };
        let places = points.iter().map(&mut place).collect();
        TruthErrors { places, errors: point_errors(&ours, &theirs) }
    }

    /// As a point stands, after the rigid and after the similarity fit \[m\].
    fn of_point(&self, point: usize) -> [Option<f64>; 3] {
        let Some(at) = self.places[point] else { return [None; 3] };
        let PointErrors { raw_m, rigid, similarity } = &self.errors;
        let fitted = |fit: &Option<FittedErrors>| fit.as_ref().map(|fit| fit.errors_m[at]);
        [Some(raw_m[at]), fitted(rigid), fitted(similarity)]
    }

    fn statistics(&self) -> Option<TruthStatistics> {
        let PointErrors { raw_m, rigid, similarity } = &self.errors;
        Some(TruthStatistics {
            raw: DistanceStatistics::of(raw_m)?,
            rigid: rigid.as_ref().and_then(|fit| DistanceStatistics::of(&fit.errors_m)),
            similarity: similarity.as_ref().and_then(|fit| DistanceStatistics::of(&fit.errors_m)),
            scale: similarity.as_ref().map(|fit| fit.scale),
        })
    }
}
