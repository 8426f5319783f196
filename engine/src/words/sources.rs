//! What measurements and knowledge are called.

use crate::network::Source;

/// A source in the words of a sentence: so far those of its key in files ([`crate::diagnose::source_key`], which
/// never changes). One that is called otherwise here becomes an arm of its own.
pub fn source_name(source: Source) -> &'static str {
    source.traits().key
}
