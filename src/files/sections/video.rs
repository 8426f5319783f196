//! `[video]`, and the film that it names: found and looked at from outside, never read whole.

use super::super::section::Section;
use super::FILE;
use crate::problem::Video;
use crate::tables::{Finding, Findings};
use std::io;
use std::path::{Path, PathBuf};

/// Ends of the names of images, in small letters.
const ENDS: [&str; 3] = ["jpg", "jpeg", "png"];

/// No number of a frame is longer than this many digits.
const MOST_DIGITS: usize = 20;

/// How the image of a frame is named: `frame_{frame:06}.jpg`, say.
#[derive(Clone, Debug, PartialEq)]
pub struct Pattern {
    text: String,
    before: String,
    /// With zeros in front up to so many.
    digits: usize,
    after: String,
}

impl Pattern {
    /// `None` unless there is one `{frame}` or `{frame:06}` in it and no other brace.
    pub fn new(text: &str) -> Option<Self> {
        let (before, rest) = text.split_once('{')?;
        let (inside, after) = rest.split_once('}')?;
        if [before, after].iter().any(|part| part.contains(['{', '}'])) {
            return None;
        }
        let digits = match inside.strip_prefix("frame")? {
            "" => 0,
            width => {
                width.strip_prefix(":0").filter(|d| d.bytes().all(|b| b.is_ascii_digit()))?.parse().ok()?
            }
        };
        let [text, before, after] = [text, before, after].map(str::to_owned);
        (digits <= MOST_DIGITS).then_some(Pattern { text, before, digits, after })
    }

    fn name(&self, frame: i64) -> String {
        let Pattern { before, digits, after, .. } = self;
        format!("{before}{frame:0digits$}{after}")
    }
}

/// `[video]`.
#[derive(Debug, PartialEq)]
pub enum VideoSettings {
    /// A folder of images, and how that of a frame is named; without, they are in the order of the frames.
    Images { folder: String, pattern: Option<Pattern> },
    /// A film in one file, and time in it minus video time \[s\].
    File { file: String, offset_s: f64 },
}

/// `[video]`: the film itself, to look at.
pub fn read(video: &Section) -> Option<VideoSettings> {
    let images = video.text("images");
    let file = video.text("file");
    let offset_s = video.any_number("offset_s").unwrap_or(0.0);
    let pattern = video.text("pattern").map(|text| Pattern::new(&text));
    if pattern == Some(None) {
        video.error("pattern", "a name with one {frame} or, with zeros in front, {frame:06} in it");
    }
    if video.has("images") == video.has("file") {
        video.error("images", "one of images and file");
        return None;
    }
    for (key, other) in [("pattern", "images"), ("offset_s", "file")] {
        if video.has(key) && !video.has(other) {
            video.error(key, &format!("nothing without {other}"));
        }
    }
    let images = images.map(|folder| VideoSettings::Images { folder, pattern: pattern.flatten() });
    images.or(file.map(|file| VideoSettings::File { file, offset_s }))
}

/// The film that problem.toml names. Its images must be of this size and there for `frames`, the numbers of
/// frames.csv; `None` there: they are not known.
pub fn find(
    problem_folder: &Path,
    settings: &VideoSettings,
    size_px: [u32; 2],
    frames: Option<&[i64]>,
    findings: &mut Findings,
) -> Option<Video> {
    match settings {
        VideoSettings::File { file, offset_s } => {
            let path = problem_folder.join(file);
            let found = match std::fs::metadata(&path) {
                Ok(about) if about.is_file() => return Some(Video::File { path, offset_s: *offset_s }),
                Ok(_) => "no file".to_owned(),
                Err(error) => error.to_string(),
            };
            findings.error(Finding::of_file(file, "the film that problem.toml names", &found));
            None
        }
        VideoSettings::Images { folder, pattern } => {
            let names = match images(&problem_folder.join(folder)) {
                Ok(names) => names,
                Err(error) => {
                    let wanted = "the folder of images that problem.toml names";
                    findings.error(Finding::of_file(folder, wanted, &error.to_string()));
                    return None;
                }
            };
            let names = match pattern {
                Some(pattern) => by_pattern(&problem_folder.join(folder), folder, pattern, frames?, findings),
                None => in_order(names, folder, frames, findings),
            };
            let checked = names.into_iter().map(|name| {
                let name = Path::new(folder).join(name?);
                let path = problem_folder.join(&name);
                check_size(&path, &name.to_string_lossy(), size_px, findings);
                Some(path)
            });
            Some(Video::Images(checked.collect()))
        }
    }
}

/// The names of the images in a folder, in order. Hidden files are passed over.
fn images(folder: &Path) -> io::Result<Vec<PathBuf>> {
    let mut names = Vec::new();
    for entry in std::fs::read_dir(folder)? {
        let name = PathBuf::from(entry?.file_name());
        let end = name.extension().map(|end| end.to_string_lossy().to_lowercase());
        let is_hidden = name.to_string_lossy().starts_with('.');
        if !is_hidden && end.is_some_and(|end| ENDS.contains(&end.as_str())) {
            names.push(name);
        }
    }
    names.sort();
    Ok(names)
}

/// One image after the other for one frame after the other.
fn in_order(
    names: Vec<PathBuf>,
    folder: &str,
    frames: Option<&[i64]>,
    findings: &mut Findings,
) -> Vec<Option<PathBuf>> {
    if let Some(frames) = frames
        && frames.len() != names.len()
    {
        let wanted = format!("as many images as frames.csv has frames ({}), or a pattern", frames.len());
        findings.error(Finding::of_file(folder, &wanted, &names.len().to_string()));
    }
    let length = |name: &PathBuf| name.as_os_str().len();
    if names.iter().any(|name| length(name) != length(&names[0])) {
        findings.warn(format!(
            "{folder}: names of images of different lengths: in their order 10 comes before 9; a pattern tells them apart"
        ));
    }
    names.into_iter().map(Some).collect()
}

/// The image of each frame that has one.
fn by_pattern(
    path: &Path,
    folder: &str,
    pattern: &Pattern,
    frames: &[i64],
    findings: &mut Findings,
) -> Vec<Option<PathBuf>> {
    let name = |frame: &i64| {
        let name = PathBuf::from(pattern.name(*frame));
        std::fs::metadata(path.join(&name)).is_ok().then_some(name)
    };
    let names: Vec<Option<PathBuf>> = frames.iter().map(name).collect();
    let missing = names.iter().filter(|name| name.is_none()).count();
    if let Some(first) = names.iter().position(Option::is_none) {
        if missing == frames.len() {
            let wanted = format!("images of the frames of frames.csv, {}", pattern.text);
            findings.error(Finding::of_file(folder, &wanted, "none"));
        } else {
            findings.warn(format!(
                "{folder}: frames without an image {}: {missing}, the first is {}",
                pattern.text, frames[first]
            ));
        }
    }
    names
}

/// Compares the size that the head of an image tells with that of the camera.
fn check_size(path: &Path, file: &str, size_px: [u32; 2], findings: &mut Findings) {
    let about = std::fs::metadata(path).map_err(|error| error.to_string());
    let read = match about {
        Ok(about) if !about.is_file() => Err("no file".to_owned()),
        Ok(_) => imagesize::size(path).map_err(|error| error.to_string()),
        Err(error) => Err(error),
    };
    let size = match read {
        Ok(size) => size,
        Err(found) => return findings.error(Finding::of_file(file, "an image, JPEG or PNG", &found)),
    };
    let [width, height] = size_px;
    if (size.width, size.height) != (width as usize, height as usize) {
        let wanted = format!("{width} x {height} px as [camera] of {} has it", FILE);
        findings.error(Finding::of_file(file, &wanted, &format!("{} x {} px", size.width, size.height)));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The head of a PNG image.
    fn png(width: u32, height: u32) -> Vec<u8> {
        let size = [width.to_be_bytes(), height.to_be_bytes()].concat();
        [b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR".as_slice(), &size, b"\x08\x02\0\0\0"].concat()
    }

    /// The head of a JPEG image, a comment first.
    fn jpeg(width: u16, height: u16) -> Vec<u8> {
        let size = [height.to_be_bytes(), width.to_be_bytes()].concat();
        [b"\xff\xd8\xff\xfe\0\x06film\xff\xc0\0\x11\x08".as_slice(), &size, b"\x03\x01\x22\0"].concat()
    }

    /// A problem folder with these files in `images`.
    fn film(files: &[(&str, Vec<u8>)]) -> tempfile::TempDir {
        let place = tempfile::tempdir().unwrap();
        std::fs::create_dir(place.path().join("images")).unwrap();
        for (name, bytes) in files {
            std::fs::write(place.path().join("images").join(name), bytes).unwrap();
        }
        place
    }

    fn by_name(pattern: &str) -> VideoSettings {
        VideoSettings::Images { folder: "images".to_owned(), pattern: Some(Pattern::new(pattern).unwrap()) }
    }

    fn by_order() -> VideoSettings {
        VideoSettings::Images { folder: "images".to_owned(), pattern: None }
    }

    /// The film of a folder with frames 7, 8 and 9 of 640 x 480 px.
    fn found(place: &tempfile::TempDir, settings: &VideoSettings) -> (Option<Video>, Findings) {
        let mut findings = Findings::default();
        let video = find(place.path(), settings, [640, 480], Some(&[7, 8, 9]), &mut findings);
        (video, findings)
    }

    fn errors(place: &tempfile::TempDir, settings: &VideoSettings) -> Vec<String> {
        found(place, settings).1.errors().map(|finding| finding.to_string()).collect()
    }

    fn images_of(place: &tempfile::TempDir, names: [Option<&str>; 3]) -> Option<Video> {
        let path = |name: &str| place.path().join("images").join(name);
        Some(Video::Images(names.iter().map(|name| name.map(path)).collect()))
    }

    #[test]
    fn patterns_name_the_images_of_frames() {
        let name = |text, frame| Pattern::new(text).map(|pattern| pattern.name(frame));
        assert_eq!(name("{frame}.png", 12).unwrap(), "12.png");
        assert_eq!(name("a_{frame:06}.jpg", 12).unwrap(), "a_000012.jpg");
        assert_eq!(name("{frame:02}b", 1234).unwrap(), "1234b");
        for wrong in [
            "a.jpg",
            "{}",
            "{frame",
            "frame}",
            "{time}",
            "{frame}{frame}",
            "{{frame}}",
            "}{frame}",
            "{frame:6}",
            "{frame:0}",
            "{frame:0+6}",
            "{frame:06x}",
            "{frame:021}",
            "{frame:099999999999999999999}",
        ] {
            assert_eq!(Pattern::new(wrong), None, "{wrong}");
        }
    }

    #[test]
    fn images_in_order_are_those_of_the_frames() {
        let place = film(&[
            ("c.JPG", jpeg(640, 480)),
            ("a.png", png(640, 480)),
            ("b.jpeg", jpeg(640, 480)),
            (".d.png", b"hidden".to_vec()),
            ("notes.txt", b"no image".to_vec()),
        ]);
        let (video, findings) = found(&place, &by_order());
        assert_eq!(video, images_of(&place, [Some("a.png"), Some("b.jpeg"), Some("c.JPG")]));
        let told = "images: names of images of different lengths: in their order 10 comes before 9; \
                    a pattern tells them apart";
        assert_eq!((findings.errors().len(), findings.warnings()), (0, &[told.to_owned()][..]));
        std::fs::rename(place.path().join("images/b.jpeg"), place.path().join("images/b.jpg")).unwrap();
        let (video, findings) = found(&place, &by_order());
        assert_eq!(video, images_of(&place, [Some("a.png"), Some("b.jpg"), Some("c.JPG")]));
        assert_eq!(findings, Findings::default());
        std::fs::remove_file(place.path().join("images/a.png")).unwrap();
        let wanted =
            "images: expected as many images as frames.csv has frames (3), or a pattern, found \"2\"";
        assert_eq!(errors(&place, &by_order()), [wanted]);
        // Where it is not known which frames there are, nothing is said of their number.
        let mut findings = Findings::default();
        find(place.path(), &by_order(), [640, 480], None, &mut findings);
        assert_eq!(findings, Findings::default());
    }

    #[test]
    fn images_by_a_pattern_may_be_missing_but_not_all() {
        let place = film(&[("f_007.png", png(640, 480)), ("f_009.png", png(640, 480))]);
        let (video, findings) = found(&place, &by_name("f_{frame:03}.png"));
        assert_eq!(video, images_of(&place, [Some("f_007.png"), None, Some("f_009.png")]));
        assert_eq!(findings.errors().len(), 0);
        assert_eq!(
            findings.warnings(),
            ["images: frames without an image f_{frame:03}.png: 1, the first is 8"]
        );
        let wanted = "images: expected images of the frames of frames.csv, f_{frame}.png, found \"none\"";
        assert_eq!(errors(&place, &by_name("f_{frame}.png")), [wanted]);
    }

    #[test]
    fn images_are_images_of_the_size_of_the_camera() {
        let place = film(&[
            ("7.png", png(641, 480)),
            ("8.png", jpeg(480, 640)),
            ("9.png", b"a text and nothing else".to_vec()),
        ]);
        let wanted = [
            "images/7.png: expected 640 x 480 px as [camera] of problem.toml has it, found \"641 x 480 px\"",
            "images/8.png: expected 640 x 480 px as [camera] of problem.toml has it, found \"480 x 640 px\"",
            "images/9.png: expected an image, JPEG or PNG, found \"Could not decode image\"",
        ];
        assert_eq!(errors(&place, &by_order()), wanted);
        assert_eq!(errors(&place, &by_name("{frame}.png")), wanted);
        for name in ["7.png", "8.png", "9.png"] {
            std::fs::remove_file(place.path().join("images").join(name)).unwrap();
        }
        std::fs::create_dir(place.path().join("images/7.png")).unwrap();
        std::fs::write(place.path().join("images/8.png"), b"").unwrap();
        std::fs::write(place.path().join("images/9.png"), &jpeg(640, 480)[..16]).unwrap();
        let wanted = [
            "images/7.png: expected an image, JPEG or PNG, found \"no file\"",
            "images/8.png: expected an image, JPEG or PNG, found \"failed to fill whole buffer\"",
            "images/9.png: expected an image, JPEG or PNG, found \"failed to fill whole buffer\"",
        ];
        assert_eq!(errors(&place, &by_order()), wanted);
    }

    #[test]
    fn a_film_or_a_folder_must_be_there() {
        let place = film(&[("film.mp4", b"a film".to_vec())]);
        let file = |file: &str| VideoSettings::File { file: file.to_owned(), offset_s: 0.5 };
        let (video, findings) = found(&place, &file("images/film.mp4"));
        let path = place.path().join("images/film.mp4");
        assert_eq!(video, Some(Video::File { path: path.clone(), offset_s: 0.5 }));
        assert_eq!(findings, Findings::default());
        // Films lie elsewhere, mostly.
        assert_eq!(found(&place, &file(path.to_str().unwrap())).0, video);
        let wanted = "images: expected the film that problem.toml names, found \"no file\"";
        assert_eq!(errors(&place, &file("images")), [wanted]);
        let absent = "No such file or directory (os error 2)";
        let wanted = format!("film.mp4: expected the film that problem.toml names, found \"{absent}\"");
        assert_eq!(errors(&place, &file("film.mp4")), [wanted]);
        let folder = VideoSettings::Images { folder: "frames".to_owned(), pattern: None };
        let wanted =
            format!("frames: expected the folder of images that problem.toml names, found \"{absent}\"");
        assert_eq!(errors(&place, &folder), [wanted]);
    }
}
