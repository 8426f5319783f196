//! LAS and LAZ: integers with a scale and an offset.

use super::{Cloud, Refusal};
use las::{PointDataBuilder, Reader, raw};
use laz::laszip::ChunkTable;
use laz::{LazItemRecordBuilder, LazItemType};
use nalgebra::Point3;
use std::cell::Cell;
use std::io::{Cursor, Seek, SeekFrom};
use std::panic::{AssertUnwindSafe, catch_unwind, set_hook, take_hook};
use std::sync::Once;

/// Points that are decoded at once.
const AT_ONCE: u64 = 1 << 16;
/// Points to a byte that no compressed scan reaches.
const MOST_POINTS_TO_A_BYTE: u64 = 64;

pub(super) fn read(bytes: &[u8]) -> Result<Cloud, Refusal> {
    let header = raw::Header::read_from(bytes)?;
    let legacy = u64::from(header.number_of_point_records);
    let count = header.large_file.map_or(legacy, |large| match legacy {
        0 => large.number_of_point_records,
        legacy => legacy,
    });
    let data = bytes.get(header.offset_to_point_data as usize..).unwrap_or_default().len() as u64;
    let is_compressed = header.point_data_record_format & 0x80 != 0;
    let fits = match is_compressed {
        true => count / MOST_POINTS_TO_A_BYTE <= data,
        false => u128::from(count) * u128::from(header.point_data_record_length) <= u128::from(data),
    };
    if !fits {
        return Err(format!("{count} points in {data} bytes").into());
    }
    let mut bytes = bytes.to_vec();
    if header.evlr.is_some() {
        // What extended records lie behind the points is of no use here, and their lengths would be
        // believed: none of them.
        bytes[243..247].fill(0);
    }
    if !is_compressed {
        return decode(bytes);
    }
    unless_it_panics(|| {
        check_chunks(&bytes, &header, count)?;
        decode(bytes)
    })
}

thread_local! {
    /// Whether a panic of this thread is expected and says nothing.
    static IS_QUIET: Cell<bool> = const { Cell::new(false) };
}

/// What a decoder gives. That of LAZ takes for granted that its symbols are sound: on damaged data its
/// assertions may fail, and no look at the file shows it beforehand. Their message goes nowhere; panics
/// of other threads keep theirs.
pub(super) fn unless_it_panics(decode: impl FnOnce() -> Result<Cloud, Refusal>) -> Result<Cloud, Refusal> {
    static HOOK: Once = Once::new();
    HOOK.call_once(|| {
        let before = take_hook();
        set_hook(Box::new(move |panic| {
            if !IS_QUIET.get() {
                before(panic);
            }
        }));
    });
    IS_QUIET.set(true);
    let cloud = catch_unwind(AssertUnwindSafe(decode));
    IS_QUIET.set(false);
    cloud.unwrap_or_else(|_| Err("damaged compressed data".into()))
}

/// The points of a file whose header keeps its promises.
fn decode(bytes: Vec<u8>) -> Result<Cloud, Refusal> {
    let mut reader = Reader::new(Cursor::new(bytes))?;
    let mut buffer = PointDataBuilder::new().for_header(reader.header()).build();
    let mut points = Vec::new();
    while reader.fill_points(AT_ONCE, &mut buffer)? > 0 {
        points.extend(buffer.x().zip(buffer.y()).zip(buffer.z()).map(|((x, y), z)| Point3::new(x, y, z)));
    }
    match points.iter().position(|point| !point.iter().all(|v| v.is_finite())) {
        Some(at) => Err(format!("point {at} is {:?}", points[at].coords.as_slice()).into()),
        None => Ok(Cloud { points, ..Cloud::default() }),
    }
}

/// Whether the compressed chunks can hold so many points and lie in the file: the decoder believes it.
fn check_chunks(bytes: &[u8], header: &raw::Header, count: u64) -> Result<(), Refusal> {
    let las = las::Header::new(Cursor::new(bytes))?;
    let vlr = las.laz_vlr()?;
    let format = header.point_data_record_format & 0x3f;
    let is_layered = format >= 6;
    let wanted = LazItemRecordBuilder::default_for_point_format_id(format, las.point_format().extra_bytes)?;
    let matches = vlr.items().len() == wanted.len()
        && vlr.items().iter().zip(&wanted).all(|(item, wanted)| {
            let is_known = if is_layered { 3..=4 } else { 1..=2 }.contains(&item.version());
            is_known && (item.item_type(), item.size()) == (wanted.item_type(), wanted.size())
        });
    if !matches {
        return Err(format!("items {:?} for points of format {format}", vlr.items()).into());
    }
    let mut described = Vec::new();
    vlr.write_to(&mut described)?;
    match (described.first(), is_layered) {
        // One stream of all points, without a table.
        (Some(1), false) => return Ok(()),
        (Some(2), false) | (Some(3), true) => {}
        (kind, _) => return Err(format!("compressor {kind:?} for points of format {format}").into()),
    }
    let word = |at: u64| -> Result<u32, Refusal> {
        let word = usize::try_from(at).ok().and_then(|at| bytes.get(at..at.checked_add(4)?));
        let word = word.ok_or_else(|| format!("{} bytes, cut off in the chunks", bytes.len()))?;
        Ok(u32::from_le_bytes(word.try_into()?))
    };
    // The offset of the table stands before the points, or at the end when it was found too late.
    let start = u64::from(header.offset_to_point_data);
    let place = |at: u64| Ok::<_, Refusal>(u64::from(word(at)?) | u64::from(word(at + 4)?) << 32);
    let at_end = (bytes.len() as u64).saturating_sub(8);
    let is_place = |at: &u64| *at > start && *at < bytes.len() as u64;
    let table_at = [place(start)?, place(at_end)?].into_iter().find(is_place).ok_or("no table of chunks")?;
    if u64::from(word(table_at + 4)?) > bytes.len() as u64 {
        return Err(format!("{} chunks in {} bytes", word(table_at + 4)?, bytes.len()).into());
    }
    let mut source = Cursor::new(bytes);
    source.seek(SeekFrom::Start(start))?;
    let table = ChunkTable::read_from(&mut source, &vlr)?;
    let layers: u64 = vlr
        .items()
        .iter()
        .map(|item| match item.item_type() {
            LazItemType::Point14 => 9,
            LazItemType::RGBNIR14 => 2,
            LazItemType::Byte14(bytes) => u64::from(bytes),
            _ => 1,
        })
        .sum();
    let (mut held, mut at) = (0_u64, start + 8);
    for chunk in table.as_ref() {
        if held >= count {
            break;
        }
        held = held.saturating_add(chunk.point_count);
        if is_layered {
            // The first point, the number of points, the size of each layer, the layers.
            at += u64::from(header.point_data_record_length) + 4;
            let sizes = (0..layers).map(|layer| Ok(u64::from(word(at + 4 * layer)?)));
            at += 4 * layers + sizes.sum::<Result<u64, Refusal>>()?;
            if at > bytes.len() as u64 {
                return Err(format!("{} bytes, cut off in the chunks", bytes.len()).into());
            }
        }
    }
    if held < count { Err(format!("{count} points, {held} of them in chunks").into()) } else { Ok(()) }
}
