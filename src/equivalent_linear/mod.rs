//! The column in the frequency domain, at moduli and damping compatible with its strains: what frequency-domain programs make of a site.
//! Here it tells what of a prediction is a convention of how damping is idealised.

mod column;
mod compatible;
mod curves;
mod surroundings;
mod tuning;

pub use column::{EquivalentColumn, March, Nodes, Wanted, element_count};
pub use compatible::{Base, Compatible};
pub use curves::{Curve, Curves};
pub use tuning::Tuning;
