//! `[camera]` and `[camera.refine]`.

use super::super::cells::decimal;
use super::super::section::Section;
use crate::camera::{Camera, INTERIOR, Lens, LensKeys, principal_in_image};
use crate::problem::{Calibration, Freedom, Problem, Shutter};
use nalgebra::Vector2;
use std::fmt::Write;

/// An image is no larger \[px\].
const MOST_SIZE_PX: u32 = 1_000_000;
/// A readout takes no longer \[s\].
const MOST_READOUT_S: f64 = 1.0;

/// Reads `[camera]`.
pub fn read(camera: &Section) -> Option<(Camera, Calibration, Shutter)> {
    let size = |key| {
        camera.required(key, "a size above 0", || {
            let whole = "a whole number from 1 to 1000000";
            camera
                .number(key, whole, |v| v > 0.0 && v.fract() == 0.0 && v <= f64::from(MOST_SIZE_PX))
                .map(|v| v as u32)
        })
    };
    let positive = |key| camera.required(key, "a focal length above 0", || camera.positive(key));
    let number = |key| camera.required(key, "a finite number", || camera.any_number(key));
    let size_px = (size("width"), size("height"));
    let focal = (positive("fx"), positive("fy"));
    let principal = (number("cx"), number("cy"));
    let model = camera.text("model");
    let calibration = camera.table("refine", |refine| read_refine(refine, model.as_deref()));
    let calibration = calibration.unwrap_or_default();
    let bends = calibration[3..].iter().any(|freedom| freedom.is_adjusted());
    let lens = read_lens(camera, model.as_deref(), bends);
    let readout_s = camera.any_number("readout_s").unwrap_or(0.0);
    let freedom = match camera.not_negative("readout_sigma_s").unwrap_or(0.0) {
        0.0 => Freedom::Fixed,
        sigma_s => Freedom::Prior(sigma_s),
    };
    if readout_s.abs() > MOST_READOUT_S {
        camera.error("readout_s", "at most a second from the first to the last row");
    }
    let pixel_centre = |key| camera.number(key, "0.0 or 0.5", |v| v == 0.0 || v == 0.5);
    let pixel_centre_px = pixel_centre("pixel_centre").unwrap_or(0.0);
    let calibration_centre_px = pixel_centre("calibration_pixel_centre").unwrap_or(pixel_centre_px);
    let principal_px = Vector2::new(principal.0?, principal.1?);
    let read = Camera {
        size_px: [size_px.0?, size_px.1?],
        focal_px: Vector2::new(focal.0?, focal.1?),
        principal_px: principal_in_image(principal_px, calibration_centre_px, pixel_centre_px),
        pixel_centre_px,
        lens,
    };
    if let Some(fold) = read.fold_in_image() {
        camera.warn(
            "model",
            &format!(
                "folds over inside the image, {:.0} px from the principal point; beyond, {:.1} % of the image \
                 have no rays",
                fold.radius_px,
                100.0 * fold.share
            ),
        );
    }
    Some((read, calibration, Shutter { readout_s, freedom }))
}

/// The lens of a model, or of the usual one. Where that has nothing and nothing of it is adjusted (`bends`), it is a
/// pinhole.
fn read_lens(camera: &Section, model: Option<&str>, bends: bool) -> Lens {
    if model == Some(Lens::Pinhole.keys().model) {
        for key in keys_of_all() {
            if camera.any_number(key).is_some_and(|value| value != 0.0) {
                camera.warn(key, "has no effect: the model is \"pinhole\"");
            }
        }
        return Lens::Pinhole;
    }
    let Some(keys) = model.map_or(Some(Lens::USUAL), Lens::keys_of) else {
        camera.error("model", &names(Lens::MODELS.iter()));
        return Lens::Pinhole;
    };
    let read = |keys: &[&'static str]| -> Vec<f64> {
        keys.iter().map(|key| camera.any_number(key).unwrap_or(0.0)).collect()
    };
    let (coefficients, held) = (read(keys.coefficients), read(keys.held));
    let is_straight = coefficients.iter().chain(&held).all(|value| *value == 0.0) && !bends;
    if keys == Lens::USUAL && is_straight {
        return Lens::Pinhole;
    }
    Lens::of_model(keys.model, &coefficients, &held).unwrap_or(Lens::Pinhole)
}

/// The keys of all models, each once.
fn keys_of_all() -> Vec<&'static str> {
    let mut all: Vec<&str> = Vec::new();
    for key in Lens::MODELS.iter().flat_map(|keys| keys.coefficients.iter().chain(keys.held)) {
        if !all.contains(key) {
            all.push(key);
        }
    }
    all
}

/// Models as alternatives.
fn names<'k>(models: impl Iterator<Item = &'k LensKeys>) -> String {
    let names: Vec<String> = models.map(|keys| format!("\"{}\"", keys.model)).collect();
    match names.split_last() {
        Some((last, [])) => last.clone(),
        Some((last, others)) => format!("{} or {last}", others.join(", ")),
        None => String::new(),
    }
}

/// `[camera.refine]`: what of the interior orientation is adjusted.
fn read_refine(refine: &Section, model: Option<&str>) -> Calibration {
    let mut all = Calibration::default();
    let mut set = |key: &'static str, which: std::ops::Range<usize>| {
        if let Some(freedom) = read_freedom(refine, key) {
            all[which].fill(freedom);
        }
    };
    for (key, which) in [
        ("focal_length", 0..1),
        ("fx", 0..1),
        ("fy", 0..1),
        ("principal_point", 1..3),
        ("cx", 1..2),
        ("cy", 2..3),
    ] {
        set(key, which);
    }
    let coefficients = model.and_then(Lens::keys_of).unwrap_or(Lens::USUAL).coefficients;
    if refine.has("distortion") && coefficients.is_empty() {
        let that_have = Lens::MODELS.iter().filter(|keys| !keys.coefficients.is_empty());
        refine.error("distortion", &format!("a model that has distortion, {}", names(that_have)));
    }
    set("distortion", 3..3 + coefficients.len());
    for (at, key) in coefficients.iter().enumerate() {
        set(key, 3 + at..4 + at);
    }
    debug_assert!(3 + coefficients.len() <= INTERIOR);
    all
}

/// `"free"`, `"fixed"`, or a standard deviation.
fn read_freedom(section: &Section, key: &'static str) -> Option<Freedom> {
    if !section.has(key) {
        return None;
    }
    let wanted = "\"free\", \"fixed\" or a standard deviation above 0";
    match section.text_or_number(key) {
        (Some(text), _) if text == "free" => Some(Freedom::Free),
        (Some(text), _) if text == "fixed" => Some(Freedom::Fixed),
        (_, Some(sigma)) if sigma > 0.0 && sigma.is_finite() => Some(Freedom::Prior(sigma)),
        _ => {
            section.error(key, wanted);
            None
        }
    }
}

/// Writes `[camera]`.
pub fn write(text: &mut String, problem: &Problem) {
    text.push_str("\n[camera]\n");
    let Camera { size_px: [width, height], focal_px, principal_px, pixel_centre_px, lens } = &problem.camera;
    let LensKeys { model, coefficients, held } = lens.keys();
    let _ = writeln!(text, "model = \"{model}\"\nwidth = {width}\nheight = {height}");
    let numbers = [("fx", focal_px.x), ("fy", focal_px.y), ("cx", principal_px.x), ("cy", principal_px.y)];
    let bent = coefficients.iter().copied().zip(lens.numbers());
    let (own, held_numbers) = (numbers.into_iter().chain([("pixel_centre", *pixel_centre_px)]), lens.held());
    // What most lenses do not have is not written for them.
    let held = held.iter().copied().zip(held_numbers).filter(|(_, value)| *value != 0.0);
    for (key, value) in own.chain(bent).chain(held) {
        let _ = writeln!(text, "{key} = {value:?}");
    }
    if problem.shutter.readout_s != 0.0 || problem.shutter.freedom.is_adjusted() {
        let _ = writeln!(text, "readout_s = {}", decimal(problem.shutter.readout_s, 9));
    }
    if let Freedom::Prior(sigma_s) = problem.shutter.freedom {
        let _ = writeln!(text, "readout_sigma_s = {}", decimal(sigma_s, 9));
    }
    if problem.calibration.iter().any(|freedom| freedom.is_adjusted()) {
        text.push_str("[camera.refine]\n");
        let keys = ["focal_length", "cx", "cy"].iter().chain(coefficients);
        for (key, freedom) in keys.zip(&problem.calibration) {
            let _ = match freedom {
                Freedom::Fixed => Ok(()),
                Freedom::Free => writeln!(text, "{key} = \"free\""),
                Freedom::Prior(sigma) => writeln!(text, "{key} = {sigma:?}"),
            };
        }
    }
}
