//! Symmetric block systems: pattern, elimination order, sparse Cholesky.
//!
//! The unknowns of an adjustment come in small blocks (a pose: 6, a point: 3), and so does its
//! normal matrix. It is kept as its lower triangle, in the order in which the blocks are
//! eliminated, in the compressed columns that the factorisation reads:
//!
//! ```text
//!     frames in time order        shape   targets
//!   [ C0                                          ]   Ct  pose of the camera in frame t
//!   [ x  V0                                       ]   Vt  pose of the vehicle in frame t
//!   [ m      C1                                   ]   x   both are seen by one image point
//!   [     m  x  V1                                ]   m   neighbours under the motion prior
//!   [        m      C2                            ]
//!   [            m  x  V2                         ]
//!   [ x   x  x   x  x   x   P0                    ]   P   points of the vehicle
//!   [ x   x  x   x  x   x       P1                ]
//!   [ x      x      x               G0            ]   G   targets
//! ```
//!
//! Eliminating frames first along time keeps the fill to a band and one dense block of the shape,
//! so that the work grows linearly with the length of the film. Where that is not best (few points
//! a frame, long films), an approximate minimum degree order is; [`ordering`] counts both.

pub mod chain;
pub mod cholesky;
pub mod coupling;
pub mod dense;
pub mod gradients;
pub mod matrix;
pub mod ordering;
pub mod pose_chain;
pub mod small;
pub mod tiles;
