//! A circle through measured points: a measurement of one's own, its estimate and standard deviations.
//!
//! `cargo run --release -p trackbundle-solver --example custom_measurement`

use std::error::Error;
use trackbundle_solver::nalgebra::{RowVector3, Vector1, Vector2};
use trackbundle_solver::{
    Covariance, Jacobian, Loss, Manifold, Measurement, Minimiser, MinimiserOptions, Residual, SystemBuilder,
};

/// How far outside a circle `[x, y, radius]` a measured point lies [m].
struct OnCircle {
    point: Vector2<f64>,
}

impl Residual<1, 1> for OnCircle {
    const MANIFOLDS: [Manifold; 1] = [Manifold::Vector(3)];

    fn evaluate(&self, x: &[&[f64]; 1], jacobian: Option<&mut Jacobian<1, 1>>) -> Option<Vector1<f64>> {
        let arm = self.point - Vector2::new(x[0][0], x[0][1]);
        let distance = arm.norm();
        if let Some(jacobian) = jacobian {
            jacobian.set(0, 0, &RowVector3::new(-arm.x / distance, -arm.y / distance, -1.0));
        }
        (distance > 0.0).then(|| Vector1::new(distance - x[0][2]))
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    // Measured with 1 cm; the last one is half a metre off.
    let points =
        [[5.01, 1.0], [3.5, 3.6], [0.51, 3.59], [-1.0, 1.01], [0.49, -1.61], [3.51, -1.6], [2.0, 4.5]];
    let mut builder = SystemBuilder::default();
    let circle = builder.add_block(Manifold::Vector(3), &[0.0, 0.0, 1.0], &[true; 3]);
    let measured = points.into_iter().map(|point| Measurement {
        residual: OnCircle { point: point.into() },
        blocks: [circle],
        sigma: [0.01],
    });
    builder.add_group("points", Loss::Huber { scale: 2.0 }, measured.collect());
    let system = builder.build();

    let minimum = Minimiser::new(&system)?.run(&system, system.start(), MinimiserOptions::default(), None);
    println!("{} in {} iterations: {}", minimum.stop.status(), minimum.records.len() - 1, minimum.stop);
    let covariance = Covariance::new(&system, &minimum.values)?.block(circle, circle).ok_or("held")?;
    for (at, name) in ["x", "y", "radius"].into_iter().enumerate() {
        let (value, sigma) = (system.value(&minimum.values, circle)[at], covariance[(at, at)].sqrt());
        println!("{name:6} {value:7.3} m, standard deviation {sigma:.3} m");
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use trackbundle_solver::worst_jacobian_entry;

    #[test]
    fn the_jacobian_is_that_of_its_differences() {
        let residual = OnCircle { point: Vector2::new(5.0, 1.5) };
        let entry = worst_jacobian_entry(&residual, &[&[2.0, 1.0, 2.5]], 1e-6).unwrap();
        assert!(entry.gap < 1e-8, "{entry:?}");
        assert!(residual.evaluate(&[&[5.0, 1.5, 2.5]], None).is_none(), "at the centre");
    }

    #[test]
    fn the_readme_has_this_example() {
        let source = include_str!("custom_measurement.rs");
        let begin = source.find("use std::error::Error").unwrap();
        let code = source[begin..].split("\n#[cfg(test)]").next().unwrap().trim_end();
        assert!(include_str!("../README.md").contains(code));
    }
}
