//! Scans in a build that does not read them.

use super::{Cloud, Refusal};

/// Refuses the file, and says what reads it.
pub fn read(_: &[u8]) -> Result<Cloud, Refusal> {
    Err("a file that only a build with the feature `scans` reads".into())
}

#[cfg(test)]
mod tests {
    use crate::reference::read_cloud;

    #[test]
    fn a_scan_is_refused_by_naming_the_feature() {
        let place = tempfile::tempdir().unwrap();
        for name in ["a.las", "a.laz", "a.e57", "a.pcd", "a.PLY"] {
            std::fs::write(place.path().join(name), "x").unwrap();
            let told = read_cloud(&place.path().join(name), name).unwrap_err().to_string();
            assert!(told.starts_with(name) && told.contains("feature `scans`"), "{told}");
        }
        std::fs::write(place.path().join("a.xyz"), "1 2 3\n").unwrap();
        assert_eq!(read_cloud(&place.path().join("a.xyz"), "a.xyz").unwrap().points.len(), 1);
    }
}
