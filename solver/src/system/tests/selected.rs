//! Selected blocks of the inverse and leverages are those of the dense inverse.

use super::examples::{drive, worst_block};
use crate::loss::Loss;
use crate::system::Arrangement;

#[test]
fn selected_blocks_and_leverages_are_those_of_the_dense_inverse() {
    for held_observers in [false, true] {
        for loss in [Loss::Squared, Loss::Huber { scale: 3.0 }, Loss::Tukey { scale: 200.0 }] {
            let whole = drive(None, held_observers, loss);
            let drive = drive(Some(Arrangement::Together), held_observers, loss);
            let (worst, count) = worst_block(&drive, &whole);
            assert!(worst < 1e-10, "{held_observers} {loss:?}: {worst:e}");
            assert!(count > 200, "{count}");
            let (worst, _) = worst_block(&whole, &whole);
            assert!(worst < 1e-10, "{held_observers} {loss:?}: {worst:e}");
        }
    }
}
