//! Ground, targets, cameras, and what is open.

use super::{AFTER_WIDTH, BEFORE_WIDTH, Ellipsoid, Recorded, Recorder, on_screen};
use crate::colour::{self, Colour};
use crate::path::{self, part};
use crate::scene::{Body, Ground, Pose, TargetRole};
use crate::sdk::{LineStrips3D, Mesh3D, Pinhole, Points3D};

/// The frustum of the camera is this share of its height long.
const FRUSTUM: f32 = 0.1;
/// A line along which nothing is determined is drawn in so many dashes.
const DASHES: usize = 5;

impl Recorder<'_> {
    /// A mesh where all four corners of a cell have a height, and the lines of the lattice as far as there is
    /// ground.
    pub(super) fn ground(&self) -> Recorded {
        let Ground { lines_m: [x, y], heights_m } = &self.scene.ground;
        let place = |i: usize, j: usize| {
            let height = heights_m.get(j * x.len() + i).copied().flatten();
            height.map(|z| self.local([x[i], y[j], z]))
        };
        let along_x = (0..y.len()).map(|j| (0..x.len()).map(|i| place(i, j)).collect());
        let along_y = (0..x.len()).map(|i| (0..y.len()).map(|j| place(i, j)).collect());
        let lines: Vec<Vec<Option<[f32; 3]>>> = along_x.chain(along_y).collect();
        let strips: Vec<Vec<[f32; 3]>> = lines
            .iter()
            .flat_map(|line| line.split(Option::is_none))
            .filter(|part| part.len() > 1)
            .map(|part| part.iter().flatten().copied().collect())
            .collect();
        if strips.is_empty() {
            return Ok(());
        }
        let grid = LineStrips3D::new(strips).with_colors([colour::GROUND]).with_radii([on_screen(0.4)]);
        self.fixed("world/ground", &grid)?;
        let mut vertices = Vec::new();
        let mut triangles = Vec::new();
        for j in 1..y.len() {
            for i in 1..x.len() {
                let corners = [(i - 1, j - 1), (i, j - 1), (i, j), (i - 1, j)].map(|(i, j)| place(i, j));
                if let [Some(a), Some(b), Some(c), Some(d)] = corners {
                    let first = vertices.len() as u32;
                    vertices.extend([a, b, c, d]);
                    triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
                }
            }
        }
        if triangles.is_empty() {
            return Ok(());
        }
        let count = vertices.len();
        let mesh = Mesh3D::new(vertices)
            .with_triangle_indices(triangles)
            .with_vertex_normals(vec![[0.0, 0.0, 1.0]; count])
            .with_vertex_colors(vec![colour::GROUND_BETWEEN; count]);
        self.fixed("world/ground/surface", &mesh)
    }

    pub(super) fn targets(&self) -> Recorded {
        for (role, name, colour) in [
            (TargetRole::Control, "control", colour::CONTROL),
            (TargetRole::Check, "check", colour::CHECK),
            (TargetRole::Tie, "tie", colour::TIE),
        ] {
            let of_role: Vec<_> = self.scene.targets.iter().filter(|t| t.role == role).collect();
            if of_role.is_empty() {
                continue;
            }
            let points = Points3D::new(of_role.iter().map(|t| self.local(t.position_m)))
                .with_colors([colour])
                .with_radii([on_screen(3.0)])
                .with_labels(of_role.iter().map(|t| format!("{} ({name})", t.id)))
                .with_show_labels(false);
            self.fixed(&format!("world/targets/{name}"), &points)?;
            let known = of_role.iter().filter_map(|t| {
                Some(Ellipsoid { centre: self.local(t.position_m), sigma_m: t.sigma_m?, turn_rad: 0.0 })
            });
            self.ellipsoids(&format!("world/targets/{name}/survey"), known, colour)?;
        }
        Ok(())
    }

    /// Camera and path before the adjustment, and the image of the camera after it.
    pub(super) fn camera_start(&self) -> Recorded {
        let image = format!("{}/image", path::CAMERA_START);
        self.fixed(&image, &self.pinhole(colour::BEFORE, 0.7))?;
        self.fixed(path::IMAGE, &self.pinhole(colour::AFTER, 1.0))?;
        self.camera(path::CAMERA_START, "before", &self.scene.camera.before, colour::BEFORE, BEFORE_WIDTH)
    }

    pub(super) fn camera_end(&self) -> Recorded {
        self.camera(path::CAMERA, "after", &self.scene.camera.after, colour::AFTER, AFTER_WIDTH)
    }

    fn camera(&self, entity: &str, name: &str, poses: &[Pose], colour: Colour, width: f32) -> Recorded {
        if poses.is_empty() {
            return Ok(());
        }
        let frames: Vec<usize> = (0..poses.len()).collect();
        self.poses(entity, &frames, poses)?;
        let track = format!("{}/camera/{name}", path::PATHS);
        self.strip(&track, &format!("camera {name}"), poses.iter().map(|p| p.position_m), colour, width)
    }

    /// The interior orientation; frusta of two cameras differ in length, so that both are seen.
    fn pinhole(&self, colour: Colour, length: f32) -> Pinhole {
        let camera = &self.scene.camera;
        let [focal, principal] = [camera.focal_px, camera.principal_px].map(|v| v.map(|v| v as f32));
        let height = camera.before.first().map_or(10.0, |pose| pose.position_m[2].abs()) as f32;
        Pinhole::from_focal_length_and_resolution(focal, camera.size_px.map(|v| v as f32))
            .with_principal_point(principal)
            .with_image_plane_distance(length * (FRUSTUM * height).clamp(0.5, 10.0))
            .with_line_width(on_screen(length * length))
            .with_color(colour)
    }

    /// Dashed lines along what nothing determines.
    pub(super) fn open_directions(&self, body: &Body) -> Recorded {
        for open in &body.open {
            let dash = |[from, to]: &[[f64; 3]; 2], at: usize| {
                let place = |share: f64| {
                    self.local(std::array::from_fn(|axis| from[axis] + share * (to[axis] - from[axis])))
                };
                let length = 1.0 / (2 * DASHES - 1) as f64;
                [place(2.0 * at as f64 * length), place((2.0 * at as f64 + 1.0) * length)]
            };
            let strips: Vec<[[f32; 3]; 2]> =
                open.lines_m.iter().flat_map(|line| (0..DASHES).map(move |at| dash(line, at))).collect();
            let count = strips.len();
            // One label is enough.
            let label = |at: usize| if at == count / 2 { open.name.clone() } else { String::new() };
            let lines = LineStrips3D::new(strips)
                .with_colors([colour::OPEN_DIRECTION])
                .with_radii([on_screen(1.0)])
                .with_labels((0..count).map(label))
                .with_show_labels(true);
            let entity = format!("{}/{}/{}", path::OPEN, part(&body.id), part(&open.name));
            self.fixed(&entity, &lines)?;
        }
        Ok(())
    }
}
