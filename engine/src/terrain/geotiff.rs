//! GeoTIFF: one band of heights with its place in the world. The one door of the package `tiff`.
//!
//! Rows of a raster run north to south as a rule. The place of its heights is given by
//! ModelPixelScale and one ModelTiepoint, or by an axis-aligned ModelTransformation. Where
//! GTRasterTypeGeoKey says "pixel is area" (also the default) raster place (0, 0) is the corner of the
//! first pixel, where it says "pixel is point" its centre (OGC 19-008r4, GeoTIFF 1.1).

use super::{Grid, GridFault};
use std::io::Cursor;
use std::ops::Range;
use tiff::decoder::{Decoder, DecodingResult, Limits};
use tiff::tags::Tag;
use tiff::{ColorType, TiffError};

/// Keys of the GeoKeyDirectory, and the values that matter here.
const MODEL_TYPE: u16 = 1024;
const MODEL_IS_GEOGRAPHIC: u16 = 2;
const RASTER_TYPE: u16 = 1025;
const PIXEL_IS_POINT: u16 = 2;
const UNITS_OF_LENGTH: [(u16, &str); 2] = [(3076, "ProjLinearUnits"), (4099, "VerticalUnits")];
const METRE: u16 = 9001;
const GDAL_METADATA: Tag = Tag::Unknown(42112);

type Tiff<'b> = Decoder<Cursor<&'b [u8]>>;

/// Whether bytes begin as a TIFF does.
pub fn is_tiff(bytes: &[u8]) -> bool {
    [&b"II*\0"[..], b"MM\0*", b"II+\0", b"MM\0+"].iter().any(|magic| bytes.starts_with(magic))
}

fn fault(column: &str, wanted: &str, found: impl ToString) -> GridFault {
    let column = (!column.is_empty()).then(|| column.to_owned());
    GridFault { line: None, column, wanted: wanted.to_owned(), found: found.to_string() }
}

fn unreadable(error: TiffError) -> GridFault {
    fault("", "a GeoTIFF that can be read", error)
}

/// The grid of a file; the error is the first thing that is wrong with it. Of one of more than `most_cells` only the
/// cells about `area` are read: the least and the largest x and y \[m\].
pub fn parse(bytes: &[u8], area: Option<[[f64; 2]; 2]>, most_cells: usize) -> Result<Grid, GridFault> {
    let mut limits = Limits::default();
    limits.decoding_buffer_size = most_cells.saturating_mul(size_of::<f64>());
    let mut file = Decoder::new(Cursor::new(bytes)).map_err(unreadable)?.with_limits(limits);
    let (columns, rows) = file.dimensions().map_err(unreadable)?;
    match file.colortype().map_err(unreadable)? {
        ColorType::Gray(_) => {}
        other => return Err(fault("", "one band of heights", format!("{other:?}"))),
    }
    let keys = geo_keys(&mut file)?;
    let is_point = key(&keys, RASTER_TYPE) == Some(PIXEL_IS_POINT);
    if key(&keys, MODEL_TYPE) == Some(MODEL_IS_GEOGRAPHIC) {
        return Err(fault("GTModelType", "a frame in metres", "degrees"));
    }
    for (id, name) in UNITS_OF_LENGTH {
        if let Some(unit) = key(&keys, id).filter(|unit| *unit != METRE) {
            return Err(fault(name, "metres (9001)", unit));
        }
    }
    if text(&mut file, GDAL_METADATA)?.is_some_and(|metadata| metadata.contains("role=\"scale\"")) {
        return Err(fault("GDAL_METADATA", "heights in metres", "heights that are scaled"));
    }
    let [x, y] = placing(&mut file)?;
    let no_data = match text(&mut file, Tag::GdalNodata)? {
        None => None,
        Some(text) => {
            let number = text.trim().parse::<f64>();
            Some(number.map_err(|_| fault("GDAL_NODATA", "a number", text.trim()))?)
        }
    };
    let into_pixel = if is_point { 0.0 } else { 0.5 };
    let [columns, rows] = [columns as usize, rows as usize];
    let axes = [&x, &y].map(|axis| Axis { first: axis.first + into_pixel * axis.step, step: axis.step });
    let told = || format!("{columns} x {rows}");
    let (heights, window) = if columns.saturating_mul(rows) <= most_cells {
        (heights(file.read_image().map_err(unreadable)?, no_data)?, [0..columns, 0..rows])
    } else {
        let Some([x_m, y_m]) = area else {
            return Err(fault("", &format!("a grid of at most {most_cells} cells"), told()));
        };
        let window = [axes[0].within(x_m, columns), axes[1].within(y_m, rows)];
        let cells = window.iter().map(|range| range.len()).product::<usize>();
        if cells > most_cells {
            let wanted = format!("at most {most_cells} cells where cameras, targets and vehicles are");
            return Err(fault("", &wanted, format!("{} x {}", window[0].len(), window[1].len())));
        }
        (read_window(&mut file, [columns, rows], &window, no_data)?, window)
    };
    let first = [0, 1].map(|at| axes[at].first + window[at].start as f64 * axes[at].step);
    Grid::new(first, [axes[0].step, axes[1].step], window.map(|range| range.len()), heights)
}

/// Heights of the cells in a range of columns and of rows, row by row, from those strips or tiles that they lie in.
fn read_window(
    file: &mut Tiff,
    [columns, rows]: [usize; 2],
    [wide, high]: &[Range<usize>; 2],
    no_data: Option<f64>,
) -> Result<Vec<f64>, GridFault> {
    let mut size = |tag, default: usize| -> Result<usize, GridFault> {
        let value = file.find_tag(tag).map_err(unreadable)?;
        let size = value.map_or(Ok(default as u64), |value| value.into_u64().map_err(unreadable))?;
        Ok(usize::try_from(size).unwrap_or(usize::MAX).max(1))
    };
    let is_tiled = size(Tag::TileWidth, 0)? > 1;
    let chunk = if is_tiled {
        [size(Tag::TileWidth, 1)?, size(Tag::TileLength, 1)?]
    } else {
        [columns, size(Tag::RowsPerStrip, rows)?.min(rows)]
    };
    let across = columns.div_ceil(chunk[0]);
    let mut out = vec![f64::NAN; wide.len() * high.len()];
    for chunk_row in high.start / chunk[1]..high.end.div_ceil(chunk[1]) {
        for chunk_column in wide.start / chunk[0]..wide.end.div_ceil(chunk[0]) {
            let index = u32::try_from(chunk_row * across + chunk_column).unwrap_or(u32::MAX);
            let samples = heights(file.read_chunk(index).map_err(unreadable)?, no_data)?;
            // At the far ends of the raster there is less in it.
            let first = [chunk_column * chunk[0], chunk_row * chunk[1]];
            let [width, height] = [chunk[0].min(columns - first[0]), chunk[1].min(rows - first[1])];
            if samples.len() != width * height {
                let wanted = format!("{width} x {height} heights in strip or tile {index}");
                return Err(fault("", &wanted, samples.len()));
            }
            let [from, to] = [first[0].max(wide.start), (first[0] + width).min(wide.end)];
            for row in first[1].max(high.start)..(first[1] + height).min(high.end) {
                let source = (row - first[1]) * width + from - first[0];
                let target = (row - high.start) * wide.len() + from - wide.start;
                out[target..target + to - from].copy_from_slice(&samples[source..source + to - from]);
            }
        }
    }
    Ok(out)
}

/// One axis of the world: its coordinate at raster place 0, and how it grows from pixel to pixel \[m\].
struct Axis {
    first: f64,
    step: f64,
}

impl Axis {
    /// The pixels between two coordinates, of `count`; two at the least.
    fn within(&self, [least_m, most_m]: [f64; 2], count: usize) -> Range<usize> {
        let at = |place_m: f64| (place_m - self.first) / self.step;
        let [low, high] = [at(least_m).min(at(most_m)), at(least_m).max(at(most_m))];
        let last = count.saturating_sub(2);
        let start = (low.floor().max(0.0) as usize).min(last);
        let end = (high.ceil().max(0.0) as usize).saturating_add(1).clamp((start + 2).min(count), count);
        start..end
    }
}

fn numbers(file: &mut Tiff, tag: Tag) -> Result<Option<Vec<f64>>, GridFault> {
    match file.find_tag(tag).map_err(unreadable)? {
        Some(value) => value.into_f64_vec().map(Some).map_err(unreadable),
        None => Ok(None),
    }
}

fn text(file: &mut Tiff, tag: Tag) -> Result<Option<String>, GridFault> {
    match file.find_tag(tag).map_err(unreadable)? {
        Some(value) => {
            let text = value.into_string().map_err(unreadable)?;
            Ok(Some(text.trim_end_matches('\0').to_owned()))
        }
        None => Ok(None),
    }
}

/// The keys that stand in the directory itself, with their values.
fn geo_keys(file: &mut Tiff) -> Result<Vec<(u16, u16)>, GridFault> {
    let Some(value) = file.find_tag(Tag::GeoKeyDirectoryTag).map_err(unreadable)? else {
        return Ok(Vec::new());
    };
    let words = value.into_u16_vec().map_err(unreadable)?;
    // After four words of version and count: key, where its value stands (0: here), count, value.
    let entries = words.get(4..).unwrap_or_default().chunks_exact(4);
    Ok(entries.filter(|entry| entry[1] == 0).map(|entry| (entry[0], entry[3])).collect())
}

fn key(keys: &[(u16, u16)], id: u16) -> Option<u16> {
    keys.iter().find(|(key, _)| *key == id).map(|(_, value)| *value)
}

fn placing(file: &mut Tiff) -> Result<[Axis; 2], GridFault> {
    let scale = numbers(file, Tag::ModelPixelScaleTag)?;
    let ties = numbers(file, Tag::ModelTiepointTag)?;
    let transformation = numbers(file, Tag::ModelTransformationTag)?;
    match (scale.as_deref(), ties.as_deref(), transformation.as_deref()) {
        (Some([scale_x, scale_y, scale_z, ..]), Some([i, j, k, x, y, z]), _) => {
            if !(*scale_x > 0.0 && *scale_y > 0.0) {
                let found = format!("{scale_x}, {scale_y}");
                return Err(fault("ModelPixelScale", "cell sizes above 0", found));
            }
            if ![0.0, 1.0].contains(scale_z) || z != k {
                let found = format!("scale {scale_z}, offset {}", z - k);
                return Err(fault("ModelPixelScale", "heights in metres, neither scaled nor shifted", found));
            }
            Ok([
                Axis { first: x - i * scale_x, step: *scale_x },
                Axis { first: y + j * scale_y, step: -scale_y },
            ])
        }
        (_, _, Some([xx, xy, _, x, yx, yy, _, y, ..])) => {
            if *xy != 0.0 || *yx != 0.0 {
                let wanted = "rows and columns along the axes of the world";
                return Err(fault("ModelTransformation", wanted, format!("{xx}, {xy}; {yx}, {yy}")));
            }
            Ok([Axis { first: *x, step: *xx }, Axis { first: *y, step: *yy }])
        }
        (_, Some(ties), _) if ties.len() != 6 => {
            Err(fault("ModelTiepoint", "one tie point (6 numbers)", format!("{} numbers", ties.len())))
        }
        _ => Err(fault(
            "ModelPixelScale",
            "ModelPixelScale and ModelTiepoint, or ModelTransformation",
            "neither in full",
        )),
    }
}

/// Heights row by row, NaN where there is none.
fn heights(samples: DecodingResult, no_data: Option<f64>) -> Result<Vec<f64>, GridFault> {
    fn convert<T: Copy>(samples: &[T], no_data: Option<f64>, value: impl Fn(T) -> f64) -> Vec<f64> {
        let height = |sample: &T| Some(value(*sample)).filter(|v| Some(*v) != no_data).unwrap_or(f64::NAN);
        samples.iter().map(height).collect()
    }
    Ok(match samples {
        DecodingResult::U8(samples) => convert(&samples, no_data, f64::from),
        DecodingResult::U16(samples) => convert(&samples, no_data, f64::from),
        DecodingResult::U32(samples) => convert(&samples, no_data, f64::from),
        DecodingResult::I8(samples) => convert(&samples, no_data, f64::from),
        DecodingResult::I16(samples) => convert(&samples, no_data, f64::from),
        DecodingResult::I32(samples) => convert(&samples, no_data, f64::from),
        DecodingResult::U64(samples) => convert(&samples, no_data, |v| v as f64),
        DecodingResult::I64(samples) => convert(&samples, no_data, |v| v as f64),
        // No-data is written in decimals of a single or of a double.
        DecodingResult::F32(samples) => convert(&samples, no_data.map(|v| f64::from(v as f32)), f64::from),
        DecodingResult::F64(samples) => convert(&samples, no_data, |v| v),
        DecodingResult::F16(_) => return Err(fault("", "heights of 32 or 64 bits", "floats of 16 bits")),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use tiff::encoder::colortype::{self, ColorType as Encoded};
    use tiff::encoder::{Compression, Predictor, TiffEncoder, TiffValue};

    fn whole(bytes: &[u8]) -> Result<Grid, GridFault> {
        parse(bytes, None, 1 << 20)
    }

    const HEIGHTS: [f32; 6] = [1.0, 1.5, 2.0, 3.0, -32767.0, 5.0];
    const TIE: [f64; 6] = [0.0, 0.0, 0.0, 10.0, 24.0, 0.0];
    const SCALE: [f64; 3] = [2.0, 2.0, 0.0];

    #[derive(Clone)]
    struct Tags<'a> {
        scale: Option<[f64; 3]>,
        ties: &'a [f64],
        transformation: Option<[f64; 16]>,
        keys: &'a [u16],
        no_data: Option<&'a str>,
        metadata: &'a str,
    }

    const USUAL: Tags = Tags {
        scale: Some(SCALE),
        ties: &TIE,
        transformation: None,
        keys: &[],
        no_data: Some("-32767"),
        metadata: "",
    };

    fn written<C: Encoded>(size: [u32; 2], samples: &[C::Inner], tags: &Tags, packing: Compression) -> Vec<u8>
    where
        [C::Inner]: TiffValue,
    {
        let mut bytes = Cursor::new(Vec::new());
        let mut encoder = TiffEncoder::new(&mut bytes).unwrap().with_compression(packing);
        if !matches!(packing, Compression::Uncompressed) && C::BITS_PER_SAMPLE[0] < 32 {
            encoder = encoder.with_predictor(Predictor::Horizontal);
        }
        let mut image = encoder.new_image::<C>(size[0], size[1]).unwrap();
        image.rows_per_strip(1).unwrap();
        let directory = image.encoder();
        if let Some(scale) = tags.scale {
            directory.write_tag(Tag::ModelPixelScaleTag, &scale[..]).unwrap();
        }
        if !tags.ties.is_empty() {
            directory.write_tag(Tag::ModelTiepointTag, tags.ties).unwrap();
        }
        if let Some(transformation) = tags.transformation {
            directory.write_tag(Tag::ModelTransformationTag, &transformation[..]).unwrap();
        }
        if !tags.keys.is_empty() {
            directory.write_tag(Tag::GeoKeyDirectoryTag, tags.keys).unwrap();
        }
        if let Some(no_data) = tags.no_data {
            directory.write_tag(Tag::GdalNodata, no_data).unwrap();
        }
        if !tags.metadata.is_empty() {
            directory.write_tag(GDAL_METADATA, tags.metadata).unwrap();
        }
        image.write_data(samples).unwrap();
        bytes.into_inner()
    }

    fn usual(tags: &Tags) -> Vec<u8> {
        written::<colortype::Gray32Float>([3, 2], &HEIGHTS, tags, Compression::Uncompressed)
    }

    fn wanted(first: [f64; 2]) -> String {
        let heights = vec![1.0, 1.5, 2.0, 3.0, f64::NAN, 5.0];
        // No-data is not equal to itself.
        format!("{:?}", Grid::new(first, [2.0, -2.0], [3, 2], heights))
    }

    fn found(bytes: &[u8]) -> String {
        format!("{:?}", whole(bytes))
    }

    fn refused(tags: &Tags) -> String {
        whole(&usual(tags)).unwrap_err().column.unwrap_or_default()
    }

    #[test]
    fn heights_stand_at_the_centres_of_pixels() {
        assert_eq!(found(&usual(&USUAL)), wanted([11.0, 23.0]));
        let area = [1, 1, 0, 1, RASTER_TYPE, 0, 1, 1];
        assert_eq!(found(&usual(&Tags { keys: &area, ..USUAL })), wanted([11.0, 23.0]));
        let point = [1, 1, 0, 1, RASTER_TYPE, 0, 1, PIXEL_IS_POINT];
        assert_eq!(found(&usual(&Tags { keys: &point, ..USUAL })), wanted([10.0, 24.0]));
        let tie = [1.0, 2.0, 0.0, 12.0, 20.0, 0.0];
        assert_eq!(found(&usual(&Tags { ties: &tie, ..USUAL })), wanted([11.0, 23.0]));
        let mut matrix = [0.0; 16];
        (matrix[0], matrix[3], matrix[5], matrix[7], matrix[15]) = (2.0, 10.0, -2.0, 24.0, 1.0);
        let by_matrix = Tags { scale: None, ties: &[], transformation: Some(matrix), ..USUAL };
        assert_eq!(found(&usual(&by_matrix)), wanted([11.0, 23.0]));
    }

    #[test]
    fn every_kind_of_number_and_packing_is_read() {
        use colortype::{Gray16, Gray64Float, GrayI8, GrayI16, GrayI32, GrayI64};
        let wanted = |heights: [f64; 4]| {
            format!("{:?}", Grid::new([11.0, 23.0], [2.0, -2.0], [2, 2], heights.to_vec()))
        };
        let lowest = Tags { no_data: Some("-3.40282346638529e+38"), ..USUAL };
        for (number, packing) in
            [Compression::Uncompressed, Compression::Lzw, Compression::Deflate(Default::default())]
                .into_iter()
                .enumerate()
        {
            macro_rules! check {
                ($kind:ty, $tags:expr, $samples:expr, $wanted:expr) => {
                    let bytes = written::<$kind>([2, 2], &$samples, &$tags, packing);
                    assert_eq!(found(&bytes), wanted($wanted), "{} {number}", stringify!($kind));
                };
            }
            let whole = [-3.0, 0.0, 100.0, 7.0];
            let hole = Tags { no_data: Some(" 7.0 "), ..USUAL };
            check!(GrayI8, USUAL, [-3, 0, 100, 7], whole);
            check!(GrayI16, hole, [-3, 0, 100, 7], [-3.0, 0.0, 100.0, f64::NAN]);
            check!(GrayI32, USUAL, [-3, 0, 100, 7], whole);
            check!(GrayI64, USUAL, [-3, 0, 100, 7], whole);
            check!(Gray16, USUAL, [3, 0, 65535, 7], [3.0, 0.0, 65535.0, 7.0]);
            check!(Gray64Float, USUAL, [-3.0, 0.0, 100.0, 0.1], [-3.0, 0.0, 100.0, 0.1]);
            let singles = [f32::MIN, 0.0, 1.5, f32::NAN];
            check!(colortype::Gray32Float, lowest, singles, [f64::NAN, 0.0, 1.5, f64::NAN]);
        }
    }

    /// An uncompressed file of 32 x 16 singles in two tiles, written byte by byte.
    fn tiled() -> Vec<u8> {
        let mut bytes = b"II*\0\x08\0\0\0".to_vec();
        let entries: [(u16, u16, u32, u32); 13] = [
            (256, 4, 1, 20),
            (257, 4, 1, 10),
            (258, 3, 1, 32),
            (259, 3, 1, 1),
            (262, 3, 1, 1),
            (277, 3, 1, 1),
            (322, 4, 1, 16),
            (323, 4, 1, 16),
            (324, 4, 2, 170),
            (325, 4, 2, 178),
            (339, 3, 1, 3),
            (33550, 12, 3, 186),
            (33922, 12, 6, 210),
        ];
        bytes.extend(13_u16.to_le_bytes());
        for (tag, kind, count, value) in entries {
            bytes.extend(tag.to_le_bytes());
            bytes.extend(kind.to_le_bytes());
            bytes.extend(count.to_le_bytes());
            bytes.extend(value.to_le_bytes());
        }
        bytes.extend([0; 4]);
        assert_eq!(bytes.len(), 170);
        for offset in [258_u32, 258 + 1024, 1024, 1024] {
            bytes.extend(offset.to_le_bytes());
        }
        for number in SCALE.into_iter().chain(TIE) {
            bytes.extend(number.to_le_bytes());
        }
        for tile in 0..2_u16 {
            for row in 0..16_u16 {
                for column in 0..16_u16 {
                    bytes.extend(f32::from(100 * row + 16 * tile + column).to_le_bytes());
                }
            }
        }
        bytes
    }

    #[test]
    fn tiles_are_put_together() {
        let heights = (0..10).flat_map(|row| (0..20).map(move |column| f64::from(100 * row + column)));
        let wanted = Grid::new([11.0, 23.0], [2.0, -2.0], [20, 10], heights.collect());
        assert_eq!(whole(&tiled()), wanted);
    }

    #[test]
    fn what_is_no_grid_of_metres_is_refused_by_its_tag() {
        assert_eq!(refused(&Tags { scale: None, ..USUAL }), "ModelPixelScale");
        assert_eq!(refused(&Tags { scale: Some([0.0, 2.0, 0.0]), ..USUAL }), "ModelPixelScale");
        assert_eq!(refused(&Tags { scale: Some([2.0, 2.0, 0.1]), ..USUAL }), "ModelPixelScale");
        assert_eq!(refused(&Tags { ties: &[TIE, TIE].concat(), ..USUAL }), "ModelTiepoint");
        assert_eq!(refused(&Tags { no_data: Some("none"), ..USUAL }), "GDAL_NODATA");
        assert_eq!(refused(&Tags { keys: &[1, 1, 0, 1, MODEL_TYPE, 0, 1, 2], ..USUAL }), "GTModelType");
        assert_eq!(refused(&Tags { keys: &[1, 1, 0, 1, 4099, 0, 1, 9002], ..USUAL }), "VerticalUnits");
        let scaled =
            "<GDALMetadata><Item name=\"SCALE\" sample=\"0\" role=\"scale\">0.1</Item></GDALMetadata>";
        assert_eq!(refused(&Tags { metadata: scaled, ..USUAL }), "GDAL_METADATA");
        let turned = [2.0, 0.1, 0.0, 10.0, 0.1, -2.0, 0.0, 24.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0];
        let by_matrix = Tags { scale: None, ties: &[], transformation: Some(turned), ..USUAL };
        assert_eq!(refused(&by_matrix), "ModelTransformation");
        let coloured = written::<colortype::RGB8>([2, 2], &[7; 12], &USUAL, Compression::Uncompressed);
        assert_eq!(whole(&coloured).unwrap_err().wanted, "one band of heights");
        let infinite = [f32::INFINITY, 0.0, 0.0, 0.0];
        let infinite =
            written::<colortype::Gray32Float>([2, 2], &infinite, &USUAL, Compression::Uncompressed);
        assert_eq!(whole(&infinite).unwrap_err().wanted, "finite heights");
    }

    #[test]
    fn damaged_bytes_are_an_error_and_never_a_panic() {
        let area = Some([[11.0, 13.0], [20.0, 23.0]]);
        for bytes in [usual(&USUAL), tiled()] {
            for length in 0..bytes.len() {
                let cut = whole(&bytes[..length]);
                // The last bytes of the last tile are beyond the image.
                assert!(cut.is_err() || length > 1500, "{length} of {}", bytes.len());
                let _ = parse(&bytes[..length], area, 4);
            }
            for at in 0..bytes.len().min(300) {
                for bits in [0xff, 0x01, 0x80] {
                    let mut damaged = bytes.clone();
                    damaged[at] ^= bits;
                    let _ = whole(&damaged);
                    let _ = parse(&damaged, area, 199);
                }
            }
        }
    }

    #[test]
    fn of_a_large_grid_that_is_read_which_is_needed() {
        let strips = |columns: u32, rows: u32| {
            let heights: Vec<f32> = (0..columns * rows).map(|at| (at * at % 97) as f32).collect();
            written::<colortype::Gray32Float>(
                [columns, rows],
                &heights,
                &USUAL,
                Compression::Deflate(Default::default()),
            )
        };
        for bytes in [tiled(), strips(20, 10)] {
            let all = whole(&bytes).unwrap();
            // In the first tile, across both, in the second, over the border of the grid.
            for area in [
                [[15.0, 21.0], [10.0, 18.0]],
                [[30.0, 49.5], [7.2, 13.0]],
                [[45.0, 48.0], [9.0, 20.0]],
                [[-90.0, 16.0], [20.0, 1e9]],
            ] {
                let part = parse(&bytes, Some(area), 199).unwrap();
                assert!(part.size()[0] * part.size()[1] <= 199, "{area:?}: {:?}", part.size());
                let [x, y] = area;
                for (x, y) in [(x[0], y[0]), (x[1], y[1]), (0.4 * x[0] + 0.6 * x[1], 0.5 * (y[0] + y[1]))] {
                    let near = |found: f64, wanted: f64| (found - wanted).abs() < 1e-9;
                    match (part.at(x, y), all.at(x, y)) {
                        (Ok(part), Ok(all)) => assert!(near(part.height_m, all.height_m), "{x} {y}"),
                        (part, all) => assert_eq!(part.is_ok(), all.is_ok(), "{x} {y} of {area:?}"),
                    }
                }
            }
            let refused = |area, most| parse(&bytes, area, most).unwrap_err().wanted;
            assert_eq!(refused(None, 199), "a grid of at most 199 cells");
            assert!(refused(Some([[10.0, 50.0], [4.0, 24.0]]), 50).starts_with("at most 50 cells where"));
        }
    }
}
