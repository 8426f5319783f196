//! Says what accuracy a flight will reach, from its scenario and without an image.
//!
//! `cargo run --release --no-default-features --example predict_accuracy -- problems/scenarios/paper.toml`

fn main() -> Result<(), String> {
    let scenario = std::env::args().nth(1).unwrap_or("problems/scenarios/paper.toml".to_owned());
    let predicted = trackbundle::predict_scenario(&scenario)?;
    println!("{scenario}: an image shows {:.0} m^2 of the ground", predicted.view_m2);
    for (vehicle, [plan, height, speed, heading, shape, scale]) in predicted.sigmas.iter().enumerate() {
        println!(
            "vehicle {vehicle}: track {plan:.3} m in plan and {height:.3} m in height, speed {speed:.3} m/s, \
             heading {heading:.2} deg, shape {shape:.3} m, scale {:.2} %",
            100.0 * scale
        );
    }
    Ok(())
}
