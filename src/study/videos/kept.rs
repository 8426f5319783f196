//! Videos that are judged, kept until the study is whole.

use super::{COMPARED, Difference, JudgedVehicle, JudgedVideo, Videos};
use crate::study::parts::{END, Part, line, numbers};

impl Part for Videos {
    fn to_text(&self) -> String {
        let mut text = String::new();
        for video in self {
            let video = match video {
                Err(why) => {
                    text.push_str(&format!("failed\t{}\n", why.replace(['\n', '\t'], " ")));
                    continue;
                }
                Ok(video) => video,
            };
            let told = [&video.trust, &video.stop].into_iter().chain(&video.reasons);
            let told: Vec<&str> = told.map(String::as_str).collect();
            text.push_str(&format!("video\t{}\n", told.join("\t")));
            line(&mut text, "iterations", &[video.iterations as f64]);
            for (at, vehicle) in &video.vehicles {
                line(&mut text, "vehicle", &[*at as f64, vehicle.shape_m]);
                line(&mut text, "tracks", &vehicle.tracks.map(|count| count as f64));
                for d in &vehicle.differences {
                    line(&mut text, "difference", &[d.mean, d.sigma, d.mean_ratio, d.rms_ratio]);
                }
            }
        }
        text + END
    }

    fn from_text(text: &str) -> Option<Self> {
        let mut videos = Videos::new();
        let mut place = 0;
        for row in text.strip_suffix(END)?.lines() {
            let fields: Vec<&str> = row.split('\t').collect();
            let (word, rest) = fields.split_first()?;
            match *word {
                "failed" => {
                    videos.push(Err(rest.join(" ")));
                    continue;
                }
                "video" => {
                    let [trust, stop, reasons @ ..] = rest else { return None };
                    videos.push(Ok(JudgedVideo {
                        trust: (*trust).to_owned(),
                        reasons: reasons.iter().map(|reason| (*reason).to_owned()).collect(),
                        stop: (*stop).to_owned(),
                        iterations: 0,
                        vehicles: Vec::new(),
                    }));
                    continue;
                }
                _ => {}
            }
            let Some(Ok(video)) = videos.last_mut() else { return None };
            let values = numbers(rest)?;
            match (*word, values.as_slice(), video.vehicles.last_mut()) {
                ("iterations", [count], _) => video.iterations = *count as usize,
                ("vehicle", [at, shape_m], _) => {
                    let differences = [Difference::NONE; COMPARED.len()];
                    let vehicle = JudgedVehicle { differences, shape_m: *shape_m, tracks: [0; 4] };
                    video.vehicles.push((*at as usize, vehicle));
                    place = 0;
                }
                ("tracks", [a, b, c, d], Some((_, vehicle))) => {
                    vehicle.tracks = [*a, *b, *c, *d].map(|count| count as usize);
                }
                ("difference", [mean, sigma, mean_ratio, rms_ratio], Some((_, vehicle))) => {
                    *vehicle.differences.get_mut(place)? = Difference {
                        mean: *mean,
                        sigma: *sigma,
                        mean_ratio: *mean_ratio,
                        rms_ratio: *rms_ratio,
                    };
                    place += 1;
                }
                _ => return None,
            }
        }
        Some(videos)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn videos_come_back_as_they_were() {
        let some = Difference { mean: 0.1, sigma: 1.0 / 3.0, mean_ratio: -0.3, rms_ratio: 1e-300 };
        let vehicle =
            JudgedVehicle { differences: [some; COMPARED.len()], shape_m: 0.02, tracks: [1, 0, 7, 6] };
        let video = JudgedVideo {
            trust: "with care".to_owned(),
            reasons: vec!["scale_weak".to_owned()],
            stop: "converged".to_owned(),
            iterations: 12,
            vehicles: vec![(1, vehicle)],
        };
        let plain = JudgedVideo { reasons: Vec::new(), vehicles: Vec::new(), ..video.clone() };
        let videos: Videos = vec![Ok(video), Err("no\tway".to_owned()), Ok(plain)];
        let text = videos.to_text();
        let back = Videos::from_text(&text).unwrap();
        assert_eq!(back[0], videos[0]);
        assert_eq!((&back[1], &back[2]), (&Err("no way".to_owned()), &videos[2]));
        assert!((0..text.len()).all(|at| Videos::from_text(&text[..at]).is_none()));
    }
}
