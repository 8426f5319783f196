//! Adjusts a problem folder and prints its verdict and each vehicle's track with its standard deviations.
//!
//! `cargo run --release --no-default-features --example adjust_folder -- problems/tiny`

use std::error::Error;
use trackbundle::{Options, adjust_folder};

fn main() -> Result<(), Box<dyn Error>> {
    let folder = std::env::args().nth(1).unwrap_or("problems/tiny".to_owned());
    let outcome = adjust_folder(folder, &Options::default())?;
    println!("trust: {:?}", outcome.verdict.trust);
    outcome.verdict.findings.iter().for_each(|reason| println!("  {reason}"));
    for vehicle in &outcome.problem.vehicles {
        println!("{}: time [s], x, y, z [m], their standard deviations [m], speed [m/s]", vehicle.id);
        for place in outcome.track(&vehicle.id).unwrap_or_default() {
            let [x, y, z] = place.sigma_m.unwrap_or([f64::NAN; 3]);
            println!(
                "{:8.3} {:9.3} {:9.3} {:8.3}   {x:.3} {y:.3} {z:.3}   {:.2}",
                place.time_s,
                place.position.x,
                place.position.y,
                place.position.z,
                place.speed_mps.unwrap_or(f64::NAN)
            );
        }
    }
    Ok(())
}
