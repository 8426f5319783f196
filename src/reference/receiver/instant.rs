//! Time scales: all instants are nanoseconds of GPS time since its beginning, 1980-01-06.

use chrono::{NaiveDate, NaiveDateTime, TimeDelta};

/// How civil time is counted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TimeScale {
    /// GPS time, without leap seconds.
    Gpst,
    /// Coordinated universal time.
    Utc,
    /// Japan standard time, UTC + 9 h.
    Jst,
}

impl TimeScale {
    /// By its name.
    pub fn named(name: &str) -> Option<Self> {
        match name {
            "GPST" => Some(TimeScale::Gpst),
            "UTC" => Some(TimeScale::Utc),
            "JST" => Some(TimeScale::Jst),
            _ => None,
        }
    }
}

/// GPS time less UTC \[s\] from a day on (IERS Bulletin C; none was announced since).
const LEAP_SECONDS: [(i32, u32, i64); 8] = [
    (2017, 1, 18),
    (2015, 7, 17),
    (2012, 7, 16),
    (2009, 1, 15),
    (2006, 1, 14),
    (1999, 1, 13),
    (1997, 7, 12),
    (1996, 1, 11),
];

fn leap_seconds(utc: NaiveDateTime) -> Option<i64> {
    let begins = |year, month| NaiveDate::from_ymd_opt(year, month, 1);
    LEAP_SECONDS
        .iter()
        .find(|(year, month, _)| begins(*year, *month).is_some_and(|day| utc.date() >= day))
        .map(|found| found.2)
}

/// Nanoseconds of GPS time; `None` before 1996, and beyond 2262.
pub fn gps_ns(civil: NaiveDateTime, scale: TimeScale) -> Option<i64> {
    let begin = NaiveDate::from_ymd_opt(1980, 1, 6)?.and_hms_opt(0, 0, 0)?;
    let utc = match scale {
        TimeScale::Jst => civil.checked_sub_signed(TimeDelta::hours(9))?,
        TimeScale::Utc | TimeScale::Gpst => civil,
    };
    let ns = (utc - begin).num_nanoseconds()?;
    let leap_s = leap_seconds(utc)?;
    Some(if scale == TimeScale::Gpst { ns } else { ns.checked_add(leap_s * 1_000_000_000)? })
}

/// Nanoseconds of GPS time from a week and seconds in it.
pub fn of_week(week: f64, seconds: f64) -> Option<i64> {
    let is_week = week.fract() == 0.0 && (0.0..=10_000.0).contains(&week);
    let is_second = (0.0..604_800.0).contains(&seconds);
    (is_week && is_second).then(|| week as i64 * 604_800_000_000_000 + (seconds * 1e9).round() as i64)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(text: &str, scale: TimeScale) -> Option<i64> {
        gps_ns(NaiveDateTime::parse_from_str(text, "%Y-%m-%d %H:%M:%S%.f").unwrap(), scale)
    }

    #[test]
    fn scales_differ_by_leap_seconds_and_hours() {
        let gps = at("2026-05-01 10:00:18.25", TimeScale::Gpst).unwrap();
        assert_eq!(at("2026-05-01 10:00:00.25", TimeScale::Utc), Some(gps));
        assert_eq!(at("2026-05-01 19:00:00.25", TimeScale::Jst), Some(gps));
        // The second before and after the last leap second.
        let before = at("2016-12-31 23:59:59", TimeScale::Utc).unwrap();
        assert_eq!(at("2017-01-01 00:00:00", TimeScale::Utc), Some(before + 2_000_000_000));
        assert_eq!(at("1995-01-01 00:00:00", TimeScale::Utc), None);
    }

    #[test]
    fn weeks_are_counted_from_1980() {
        // 2026-05-01 is the Friday of week 2416.
        let gps = at("2026-05-01 10:00:00.2", TimeScale::Gpst);
        assert_eq!(of_week(2416.0, 5.0 * 86_400.0 + 36_000.2), gps);
        assert_eq!(of_week(2416.5, 0.0), None);
        assert_eq!(of_week(2416.0, 604_800.0), None);
    }
}
