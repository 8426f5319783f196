//! In which order the blocks are eliminated.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::sparse::SymbolicSparseColMat;
use faer::sparse::linalg::amd;

/// An elimination order and what it costs.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Ordering {
    /// The block at each position.
    pub order: Vec<usize>,
    /// Multiplications and additions of one factorisation.
    pub flops: f64,
    /// Which elimination it follows.
    pub elimination: Elimination,
}

/// How the unknowns of a system are eliminated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Elimination {
    /// Sparse, the blocks in the order in which they were declared.
    AsDeclared,
    /// Sparse, by approximate minimum degree on the graph of the blocks.
    MinimumDegree,
    /// Observers and bodies along time, by the innovations of what image points see of them; then the shapes of
    /// all bodies jointly, with the rest, as one dense system.
    JointBodies,
    /// Each body along time with its shape, separately; then observers and the rest by conjugate gradients.
    SeparateBodies,
}

/// The cheaper of the declared order and approximate minimum degree, by counted operations.
///
/// `dims` are the sizes of the blocks; `neighbours[a]` lists every block that shares a measurement
/// with `a`, sorted, without `a` itself.
pub(crate) fn cheapest(dims: &[usize], neighbours: &[Vec<usize>]) -> Ordering {
    let declared: Vec<usize> = (0..dims.len()).collect();
    let degree = minimum_degree(neighbours).map(|order| {
        let flops = factorisation_flops(dims, neighbours, &order, f64::INFINITY);
        Ordering { order, flops, elimination: Elimination::MinimumDegree }
    });
    // Of the worse order no more is counted than that it is worse: its fill may be the square of the unknowns.
    let most = degree.as_ref().map_or(f64::INFINITY, |degree| degree.flops);
    let flops = factorisation_flops(dims, neighbours, &declared, most);
    match degree {
        Some(degree) if degree.flops < flops => degree,
        _ => Ordering { order: declared, flops, elimination: Elimination::AsDeclared },
    }
}

/// Approximate minimum degree on the block graph; `None` where it cannot be had.
fn minimum_degree(neighbours: &[Vec<usize>]) -> Option<Vec<usize>> {
    let n = neighbours.len();
    let mut column_starts = vec![0];
    let mut rows = Vec::new();
    for (column, list) in neighbours.iter().enumerate() {
        rows.extend(list.iter().copied().filter(|&row| row < column));
        column_starts.push(rows.len());
    }
    let upper = SymbolicSparseColMat::<usize>::new_checked(n, n, column_starts, None, rows);
    let (mut order, mut position) = (vec![0; n], vec![0; n]);
    let request = amd::order_scratch::<usize>(n, upper.compute_nnz());
    amd::order(
        &mut order,
        &mut position,
        upper.as_ref(),
        amd::Control::default(),
        MemStack::new(&mut MemBuffer::try_new(request).ok()?),
    )
    .ok()?;
    Some(order)
}

/// Operations of a Cholesky factorisation in this order, from its exact fill: the column of a block
/// of size `d` with `h` rows below and in it costs about `d h^2`. Once there are more than `most`, those so far.
pub(crate) fn factorisation_flops(
    dims: &[usize],
    neighbours: &[Vec<usize>],
    order: &[usize],
    most: f64,
) -> f64 {
    let mut position = vec![0; order.len()];
    for (at, &block) in order.iter().enumerate() {
        position[block] = at;
    }
    // The rows of a column of the factor: its own below the diagonal, and those of its children.
    let mut below: Vec<Vec<usize>> = vec![Vec::new(); order.len()];
    let mut children: Vec<Vec<usize>> = vec![Vec::new(); order.len()];
    let mut seen_in = vec![usize::MAX; order.len()];
    let mut flops = 0.0;
    for (at, &block) in order.iter().enumerate() {
        let mut rows = Vec::new();
        seen_in[at] = at;
        let mut take = |row: usize| {
            if row > at && seen_in[row] != at {
                seen_in[row] = at;
                rows.push(row);
            }
        };
        neighbours[block].iter().for_each(|&other| take(position[other]));
        for child in std::mem::take(&mut children[at]) {
            std::mem::take(&mut below[child]).into_iter().for_each(&mut take);
        }
        let height = dims[block] + rows.iter().map(|&row| dims[order[row]]).sum::<usize>();
        flops += dims[block] as f64 * (height * height) as f64;
        if flops > most {
            break;
        }
        if let Some(&parent) = rows.iter().min() {
            children[parent].push(at);
        }
        below[at] = rows;
    }
    flops
}

#[cfg(test)]
mod tests {
    use super::*;

    fn graph(n: usize, edges: &[(usize, usize)]) -> Vec<Vec<usize>> {
        let mut neighbours = vec![Vec::new(); n];
        for &(a, b) in edges {
            neighbours[a].push(b);
            neighbours[b].push(a);
        }
        neighbours.iter_mut().for_each(|list| list.sort_unstable());
        neighbours
    }

    /// The same count from a dense symbolic elimination.
    fn flops_by_dense_elimination(dims: &[usize], neighbours: &[Vec<usize>], order: &[usize]) -> f64 {
        let n = dims.len();
        let mut filled = vec![vec![false; n]; n];
        for (a, list) in neighbours.iter().enumerate() {
            list.iter().for_each(|&b| filled[a][b] = true);
        }
        let mut flops = 0.0;
        for (at, &block) in order.iter().enumerate() {
            let left: Vec<_> = order[at + 1..].iter().copied().filter(|&b| filled[block][b]).collect();
            let height = dims[block] + left.iter().map(|&b| dims[b]).sum::<usize>();
            flops += (dims[block] * height * height) as f64;
            for &a in &left {
                left.iter().filter(|&&b| a != b).for_each(|&b| filled[a][b] = true);
            }
        }
        flops
    }

    #[test]
    fn a_star_is_eliminated_from_its_leaves() {
        let edges: Vec<_> = (1..30).map(|leaf| (0, leaf)).collect();
        let neighbours = graph(30, &edges);
        let found = cheapest(&[3; 30], &neighbours);
        assert_eq!(found.elimination, Elimination::MinimumDegree);
        assert_eq!(found.flops, 29.0 * 3.0 * 36.0 + 3.0 * 9.0);
    }

    #[test]
    fn of_the_worse_order_no_more_is_counted_than_that_it_is_worse() {
        let edges: Vec<_> = (1..30).map(|leaf| (0, leaf)).collect();
        let (neighbours, order) = (graph(30, &edges), (0..30).collect::<Vec<_>>());
        let first = 3.0 * 90.0 * 90.0;
        assert_eq!(factorisation_flops(&[3; 30], &neighbours, &order, 100.0), first);
        assert!(factorisation_flops(&[3; 30], &neighbours, &order, f64::INFINITY) > 5.0 * first);
    }

    #[test]
    fn a_chain_stays_as_it_is() {
        let edges: Vec<_> = (1..30).map(|next| (next - 1, next)).collect();
        assert_eq!(cheapest(&[6; 30], &graph(30, &edges)).elimination, Elimination::AsDeclared);
    }

    #[test]
    fn flops_agree_with_a_dense_elimination() {
        let edges: Vec<_> = (0..40)
            .flat_map(|a| (a + 1..40).map(move |b| (a, b)))
            .filter(|(a, b)| (a * 7 + b * 13) % 11 == 0)
            .collect();
        let neighbours = graph(40, &edges);
        let dims: Vec<_> = (0..40).map(|i| 1 + i % 6).collect();
        let found = cheapest(&dims, &neighbours);
        let mut sorted = found.order.clone();
        sorted.sort_unstable();
        assert_eq!(sorted, (0..40).collect::<Vec<_>>(), "a permutation");
        for order in [found.order, (0..40).rev().collect()] {
            assert_eq!(
                factorisation_flops(&dims, &neighbours, &order, f64::INFINITY),
                flops_by_dense_elimination(&dims, &neighbours, &order)
            );
        }
    }
}
