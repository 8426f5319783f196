//! Symmetric block systems: pattern, elimination order, sparse Cholesky.
//!
//! The unknowns of an adjustment come in small blocks (a pose: 6, a point: 3), and so does its
//! normal matrix. It is kept as its lower triangle, in the order in which the blocks are
//! eliminated, in the compressed columns that the factorisation reads:
//!
//! ```text
//!     moments in time order       shape   static
//!   [ C0                                          ]   Ct  pose of the observer at moment t
//!   [ x  V0                                       ]   Vt  pose of the body at moment t
//!   [ m      C1                                   ]   x   both are seen by one image point
//!   [     m  x  V1                                ]   m   neighbours under the motion prior
//!   [        m      C2                            ]
//!   [            m  x  V2                         ]
//!   [ x   x  x   x  x   x   P0                    ]   P   points of the body
//!   [ x   x  x   x  x   x       P1                ]
//!   [ x      x      x               G0            ]   G   static points
//! ```
//!
//! Eliminating poses first along time keeps the fill to a band and one dense block of the shape,
//! so that the work grows linearly with the number of moments. Where that is not best (few points
//! a moment, many moments), an approximate minimum degree order is; [`ordering`] counts both.

pub(crate) mod chain;
pub(crate) mod cholesky;
pub(crate) mod coupling;
pub(crate) mod dense;
pub(crate) mod gradients;
pub(crate) mod matrix;
pub(crate) mod ordering;
pub(crate) mod pose_chain;
pub(crate) mod small;
pub(crate) mod tiles;
