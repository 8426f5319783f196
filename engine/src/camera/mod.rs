//! Interior orientation: from points in the camera frame to pixels and back.
//!
//! The camera looks along z, x to the right, y down. Pixels are in the convention of the principal
//! point `cx`, `cy`; [`Camera::pixel_centre_px`] says which that is.

mod brown;
mod fisheye;
mod fold;
mod interior;
mod model;

pub use brown::Brown;
pub use fisheye::Fisheye;
pub use interior::INTERIOR;
use model::COEFFICIENTS;
pub use model::{LensKeys, LensModel};
use nalgebra::{Matrix2, Matrix2x3, SMatrix, Vector2, Vector3};

/// Points nearer to the camera's plane than this are not seen \[m\].
const LEAST_DEPTH_M: f64 = 1e-3;

/// A calibrated camera.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    /// Width and height of the image \[px\].
    pub size_px: [u32; 2],
    /// Focal lengths `fx`, `fy` \[px\].
    pub focal_px: Vector2<f64>,
    /// Principal point `cx`, `cy` \[px\].
    pub principal_px: Vector2<f64>,
    /// Where the centre of the first pixel lies, in both coordinates: 0, or 0.5 where its corner is
    /// at 0 \[px\].
    pub pixel_centre_px: f64,
    /// Lens distortion.
    pub lens: Lens,
}

/// Declares the lens models that there are, beside that without distortion: everything else asks a lens.
macro_rules! lens_models {
    ($($(#[$doc:meta])* $name:ident),*) => {
        /// How a lens departs from a pinhole.
        #[derive(Clone, Debug, PartialEq)]
        pub enum Lens {
            /// Not at all.
            Pinhole,
            $($(#[$doc])* $name($name),)*
        }

        impl Lens {
            /// The keys of all models.
            pub const MODELS: &'static [LensKeys] = &[Lens::PINHOLE, $($name::KEYS),*];

            /// The lens of a model with these numbers, in the order of its keys; `None` of a model that is not
            /// known.
            pub fn of_model(model: &str, coefficients: &[f64], held: &[f64]) -> Option<Lens> {
                let mut all = [0.0; COEFFICIENTS];
                all.iter_mut().zip(coefficients).for_each(|(to, from)| *to = *from);
                match model {
                    _ if model == Lens::PINHOLE.model => Some(Lens::Pinhole),
                    $(_ if model == $name::KEYS.model => Some(Lens::$name($name::of_numbers(&all, held))),)*
                    _ => None,
                }
            }

            /// The keys of its model.
            pub fn keys(&self) -> LensKeys {
                match self {
                    Lens::Pinhole => Lens::PINHOLE,
                    $(Lens::$name(_) => $name::KEYS,)*
                }
            }

            /// Its coefficients; zero beyond those that it has.
            pub fn numbers(&self) -> [f64; COEFFICIENTS] {
                match self {
                    Lens::Pinhole => [0.0; COEFFICIENTS],
                    $(Lens::$name(lens) => lens.numbers(),)*
                }
            }

            /// The numbers that are held, in the order of their keys.
            pub fn held(&self) -> Vec<f64> {
                match self {
                    Lens::Pinhole => Vec::new(),
                    $(Lens::$name(lens) => lens.held(),)*
                }
            }

            #[inline(always)]
            fn near(&self, coefficients: &[f64; COEFFICIENTS]) -> Lens {
                match self {
                    Lens::Pinhole => Lens::Pinhole,
                    $(Lens::$name(lens) => Lens::$name(lens.near(coefficients)),)*
                }
            }

            #[inline(always)]
            fn distort(&self, ray: &Vector2<f64>) -> Option<Vector2<f64>> {
                match self {
                    Lens::Pinhole => Some(*ray),
                    $(Lens::$name(lens) => lens.distort(ray),)*
                }
            }

            #[inline(always)]
            fn undistort(&self, distorted: &Vector2<f64>) -> Option<Vector2<f64>> {
                match self {
                    Lens::Pinhole => Some(*distorted),
                    $(Lens::$name(lens) => lens.undistort(distorted),)*
                }
            }

            /// The derivative of [`Lens::distort`] by something by which the ray has this one.
            #[inline(always)]
            fn chain<const N: usize>(
                &self,
                ray: &Vector2<f64>,
                ray_by: SMatrix<f64, 2, N>,
            ) -> SMatrix<f64, 2, N> {
                match self {
                    Lens::Pinhole => ray_by,
                    $(Lens::$name(lens) => lens.distort_jacobian(ray) * ray_by,)*
                }
            }

            fn by_coefficients(&self, ray: &Vector2<f64>) -> SMatrix<f64, 2, COEFFICIENTS> {
                match self {
                    Lens::Pinhole => SMatrix::zeros(),
                    $(Lens::$name(_) => $name::by_coefficients(ray),)*
                }
            }

            #[inline(always)]
            fn skew_px(&self) -> f64 {
                match self {
                    Lens::Pinhole => 0.0,
                    $(Lens::$name(lens) => lens.skew_px(),)*
                }
            }
        }
    };
}

lens_models!(
    /// Radial and tangential, as in OpenCV.
    Brown,
    /// By the angle off the axis, as in OpenCV's fisheye module.
    Fisheye
);

impl Lens {
    const PINHOLE: LensKeys = LensKeys { model: "pinhole", coefficients: &[], held: &[] };
    /// The model of a camera that names none.
    pub const USUAL: LensKeys = Brown::KEYS;

    /// The keys of a model; `None` of one that is not known.
    pub fn keys_of(model: &str) -> Option<LensKeys> {
        Lens::MODELS.iter().copied().find(|keys| keys.model == model)
    }
}

/// How much of an image a lens model leaves without rays, because it folds over inside.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fold {
    /// Distance from the principal point to the nearest pixel without a ray \[px\].
    pub radius_px: f64,
    /// Share of the image that has no rays, above 0 to 1.
    pub share: f64,
}

/// A principal point in the convention of the image points, from one in that of its calibration: each
/// is given by where it has the centre of the first pixel \[px\].
pub fn principal_in_image(
    calibrated_px: Vector2<f64>,
    calibration_centre_px: f64,
    image_centre_px: f64,
) -> Vector2<f64> {
    calibrated_px.add_scalar(image_centre_px - calibration_centre_px)
}

impl Camera {
    /// The pixel of a point in the camera frame \[m\]; `None` behind the camera, or outside the cone
    /// in which the lens model is one to one.
    pub fn project(&self, point_in_camera: &Vector3<f64>) -> Option<Vector2<f64>> {
        Some(self.pixel(&self.lens.distort(&ray_of(point_in_camera)?)?))
    }

    /// The pixel of a distorted ray.
    #[inline(always)]
    fn pixel(&self, distorted: &Vector2<f64>) -> Vector2<f64> {
        let sheared = Vector2::new(self.lens.skew_px() * distorted.y, 0.0);
        self.focal_px.component_mul(distorted) + sheared + self.principal_px
    }

    /// Derivative of a pixel by the distorted ray \[px\].
    #[inline(always)]
    fn pixel_by_distorted(&self) -> Matrix2<f64> {
        Matrix2::new(self.focal_px.x, self.lens.skew_px(), 0.0, self.focal_px.y)
    }

    /// [`Camera::project`] with its derivative by the point, 2 x 3 \[px/m\].
    pub fn project_with_jacobian(
        &self,
        point_in_camera: &Vector3<f64>,
    ) -> Option<(Vector2<f64>, Matrix2x3<f64>)> {
        let ray = ray_of(point_in_camera)?;
        let inverse_depth = 1.0 / point_in_camera.z;
        #[rustfmt::skip]
        let ray_by_point = Matrix2x3::new(
            inverse_depth, 0.0, -ray.x * inverse_depth,
            0.0, inverse_depth, -ray.y * inverse_depth,
        );
        let distorted = self.lens.distort(&ray)?;
        let distorted_by_point: Matrix2x3<f64> = self.lens.chain(&ray, ray_by_point);
        Some((self.pixel(&distorted), self.pixel_by_distorted() * distorted_by_point))
    }

    /// The direction `(x/z, y/z)` that a pixel looks along, the distortion removed; `None` where no
    /// direction of the lens model leads to this pixel.
    pub fn ray(&self, image_px: &Vector2<f64>) -> Option<Vector2<f64>> {
        let off_px = image_px - self.principal_px;
        let y = off_px.y / self.focal_px.y;
        let x = (off_px.x - self.lens.skew_px() * y) / self.focal_px.x;
        self.lens.undistort(&Vector2::new(x, y))
    }

    /// Where the image begins and ends: outer edges of its first and last pixels \[px\].
    fn edges_px(&self) -> [[f64; 2]; 2] {
        self.size_px.map(|size| {
            let begin = self.pixel_centre_px - 0.5;
            [begin, begin + f64::from(size)]
        })
    }

    /// Whether a pixel lies in the image.
    pub fn contains(&self, image_px: &Vector2<f64>) -> bool {
        let [[left, right], [top, bottom]] = self.edges_px();
        (left..=right).contains(&image_px.x) && (top..=bottom).contains(&image_px.y)
    }

    /// When the row of `v_px` is read out, as a share of the readout time (from the first to the last
    /// row) after the middle row: -0.5 for the first row, 0.5 for the last.
    pub fn row_delay(&self, v_px: f64) -> f64 {
        let last = f64::from(self.size_px[1].max(2) - 1);
        (v_px - self.pixel_centre_px) / last - 0.5
    }

    /// Whether, and where, the lens model folds over inside the image; `None` where every pixel has a
    /// ray.
    pub fn fold_in_image(&self) -> Option<Fold> {
        const NODES: usize = 64;
        let [[left, right], [top, bottom]] = self.edges_px();
        let along = |[begin, end]: [f64; 2], at: usize| begin + (end - begin) * at as f64 / NODES as f64;
        let place = |i: usize, j: usize| Vector2::new(along([left, right], i), along([top, bottom], j));
        let is_blind = |place: &Vector2<f64>| self.ray(place).is_none();
        let blind: Vec<Vec<bool>> =
            (0..=NODES).map(|j| (0..=NODES).map(|i| is_blind(&place(i, j))).collect()).collect();
        let count = blind.iter().flatten().filter(|blind| **blind).count();
        // Nodes without a ray beside one that has one; all of them where no node has one.
        let mut border = Vec::new();
        for (i, j) in (0..=NODES).flat_map(|j| (0..=NODES).map(move |i| (i, j))) {
            let beside = [(i.wrapping_sub(1), j), (i + 1, j), (i, j.wrapping_sub(1)), (i, j + 1)];
            let sees = |(i, j): &(usize, usize)| blind.get(*j).and_then(|row| row.get(*i)) == Some(&false);
            if blind[j][i] && (beside.iter().any(sees) || count == (NODES + 1) * (NODES + 1)) {
                border.push(place(i, j));
            }
        }
        // From the principal point, which always has a ray, towards a pixel without one.
        let reach = |place: &Vector2<f64>| {
            let arm = place - self.principal_px;
            let (mut seen, mut unseen) = (0.0, 1.0);
            for _ in 0..20 {
                let middle = 0.5 * (seen + unseen);
                if is_blind(&(self.principal_px + middle * arm)) { unseen = middle } else { seen = middle }
            }
            unseen * arm.norm()
        };
        let radius_px = border.iter().map(reach).reduce(f64::min)?;
        Some(Fold { radius_px, share: count as f64 / ((NODES + 1) * (NODES + 1)) as f64 })
    }
}

fn ray_of(point_in_camera: &Vector3<f64>) -> Option<Vector2<f64>> {
    (point_in_camera.z > LEAST_DEPTH_M).then(|| point_in_camera.xy() / point_in_camera.z)
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// A camera of each kind, the distorted ones stronger than any real lens of this class.
    pub(crate) fn cameras() -> [Camera; 4] {
        let pinhole = Camera {
            size_px: [3840, 2160],
            focal_px: Vector2::new(2680.0, 2650.0),
            principal_px: Vector2::new(1925.0, 1070.0),
            pixel_centre_px: 0.0,
            lens: Lens::Pinhole,
        };
        let brown = Brown::new([-0.11, 0.08, 0.002, -0.001, -0.02]);
        let sheared = Brown::with([-0.11, 0.08, 0.002, -0.001, -0.02], [0.03, -7.5]);
        let fisheye = Fisheye::new([-0.13, 0.07, -0.09, 0.04]);
        let with = |lens: Lens| Camera { lens, ..pinhole.clone() };
        [pinhole.clone(), with(Lens::Brown(brown)), with(Lens::Fisheye(fisheye)), with(Lens::Brown(sheared))]
    }

    fn pixels() -> impl Iterator<Item = Vector2<f64>> {
        (0..=8).flat_map(|i| (0..=8).map(move |j| Vector2::new(480.0 * f64::from(i), 270.0 * f64::from(j))))
    }

    #[test]
    fn a_pixel_comes_back_from_its_ray() {
        for camera in cameras() {
            for pixel in pixels() {
                let ray = camera.ray(&pixel).expect("inside the image");
                let back = camera.project(&Vector3::new(ray.x * 60.0, ray.y * 60.0, 60.0)).unwrap();
                assert!((back - pixel).norm() < 1e-9, "{pixel} {back}");
            }
        }
    }

    #[test]
    fn the_derivative_is_that_of_its_differences() {
        for camera in cameras() {
            for pixel in pixels() {
                let ray = camera.ray(&pixel).unwrap();
                let point = Vector3::new(ray.x * 60.0, ray.y * 60.0, 60.0);
                let (value, jacobian) = camera.project_with_jacobian(&point).unwrap();
                assert_eq!(Some(value), camera.project(&point));
                for axis in 0..3 {
                    let step = Vector3::ith(axis, 1e-4);
                    let slope = (camera.project(&(point + step)).unwrap()
                        - camera.project(&(point - step)).unwrap())
                        / 2e-4;
                    assert!((slope - jacobian.column(axis)).norm() < 1e-6, "{pixel} axis {axis}");
                }
            }
        }
    }

    #[test]
    fn nothing_is_seen_behind_the_camera() {
        for camera in cameras() {
            assert_eq!(camera.project(&Vector3::new(0.1, 0.1, -1.0)), None);
            assert_eq!(camera.project(&Vector3::new(0.1, 0.1, 0.0)), None);
            assert!(camera.project_with_jacobian(&Vector3::new(0.0, 0.0, -2.0)).is_none());
        }
    }

    #[test]
    fn the_image_ends_at_its_edges() {
        for centre in [0.0, 0.5] {
            let [camera, ..] = cameras();
            let camera = Camera { pixel_centre_px: centre, ..camera };
            let is_inside = |u: f64, v: f64| camera.contains(&Vector2::new(u + centre, v + centre));
            assert!(is_inside(-0.5, -0.5) && is_inside(3839.5, 2159.5));
            assert!(!is_inside(3839.6, 10.0) && !is_inside(10.0, 2159.6));
            assert!(!is_inside(10.0, -0.6) && !is_inside(-0.6, 10.0) && !is_inside(f64::NAN, 10.0));
            assert_eq!(camera.row_delay(centre), -0.5);
            assert_eq!(camera.row_delay(2159.0 + centre), 0.5);
            assert_eq!(camera.row_delay(1079.5 + centre), 0.0);
        }
    }

    /// A calibration whose pixels begin at their corners, used with image points whose pixels have
    /// their centres at whole numbers: nothing but the numbers changes.
    #[test]
    fn a_principal_point_moves_with_the_convention_of_its_pixels() {
        let calibrated = Vector2::new(1920.5, 1080.25);
        let in_image = principal_in_image(calibrated, 0.5, 0.0);
        assert_eq!(in_image, Vector2::new(1920.0, 1079.75));
        assert_eq!(principal_in_image(in_image, 0.0, 0.5), calibrated);
        assert_eq!(principal_in_image(calibrated, 0.5, 0.5), calibrated);
        let [camera, ..] = cameras();
        let point = Vector3::new(3.0, -2.0, 60.0);
        let corners = Camera { principal_px: calibrated, pixel_centre_px: 0.5, ..camera.clone() };
        let centres = Camera { principal_px: in_image, pixel_centre_px: 0.0, ..camera };
        let difference = corners.project(&point).unwrap() - centres.project(&point).unwrap();
        assert!((difference - Vector2::new(0.5, 0.5)).norm() < 1e-12);
    }

    #[test]
    fn a_fold_inside_the_image_is_told_with_its_radius_and_its_share() {
        for camera in cameras() {
            assert_eq!(camera.fold_in_image(), None);
        }
        // Both fold at 1500 px off the principal point.
        let [pinhole, ..] = cameras();
        let square = Camera {
            size_px: [4000, 4000],
            focal_px: Vector2::new(2250.0, 2250.0),
            principal_px: Vector2::new(1999.5, 1999.5),
            ..pinhole
        };
        // r - r^3 / 3 is largest, 2/3, at 1; likewise of the angle.
        let brown = Brown::new([-1.0 / 3.0, 0.0, 0.0, 0.0, 0.0]);
        let fisheye = Fisheye::new([-1.0 / 3.0, 0.0, 0.0, 0.0]);
        for lens in [Lens::Brown(brown), Lens::Fisheye(fisheye)] {
            let fold = Camera { lens, ..square.clone() }.fold_in_image().unwrap();
            assert!((fold.radius_px - 1500.0).abs() < 0.1, "{fold:?}");
            let share = 1.0 - std::f64::consts::PI * (1500.0_f64 / 4000.0).powi(2);
            assert!((fold.share - share).abs() < 0.02, "{fold:?} {share}");
        }
    }

    #[test]
    fn every_model_is_made_of_its_own_numbers() {
        for camera in cameras() {
            let lens = camera.lens;
            let keys = lens.keys();
            assert_eq!(Lens::keys_of(keys.model), Some(keys));
            assert!(keys.coefficients.len() <= COEFFICIENTS && keys.held.len() == lens.held().len());
            assert_eq!(Lens::of_model(keys.model, &lens.numbers(), &lens.held()), Some(lens));
        }
        assert_eq!(Lens::of_model("plate", &[], &[]), None);
    }

    /// Calibrations of the DJI Mini 2 at 3840 x 2160 by users of Gyroflow: gyroflow/lens_profiles,
    /// CC0-1.0.
    #[test]
    fn real_lenses_are_inverted_over_the_whole_image() {
        let lenses = [
            (
                [2866.5623457206925, 2836.294148715731, 1894.6561734942493, 1065.3844146934664],
                [0.34628723181472676, -0.0826788962552403, 0.4083689279219956, -0.04068703128746228],
            ),
            (
                [3013.0697125662527, 3002.012656933579, 1928.06412452699, 1036.504858830158],
                [0.2517851445507729, 1.2413593891717367, -5.3644679148958305, 8.661448397633361],
            ),
        ];
        for ([fx, fy, cx, cy], k) in lenses {
            let camera = Camera {
                size_px: [3840, 2160],
                focal_px: Vector2::new(fx, fy),
                principal_px: Vector2::new(cx, cy),
                pixel_centre_px: 0.0,
                lens: Lens::Fisheye(Fisheye::new(k)),
            };
            assert_eq!(camera.fold_in_image(), None);
            for v in (0..2160).step_by(17).chain([2159]) {
                for u in (0..3840).step_by(13).chain([3839]) {
                    let pixel = Vector2::new(f64::from(u), f64::from(v));
                    let back = camera.project(&camera.ray(&pixel).unwrap().push(1.0)).unwrap();
                    assert!((back - pixel).norm() < 1e-9, "{pixel} {back}");
                }
            }
        }
    }
}
