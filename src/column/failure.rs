//! Why a run of the column ended early: when, where, and for what reason.

use crate::error::Error;
use crate::soil::Refusal;
use std::fmt;

/// A run that could not be finished; what was handed out before is valid.
#[derive(Debug)]
pub struct Failure {
    /// Time reached, s.
    pub time_s: f64,
    /// Depth of the trouble, m.
    pub depth_m: f64,
    /// The reason.
    pub cause: Cause,
}

/// The reason of a [`Failure`].
#[derive(Debug)]
pub enum Cause {
    /// Newton's iteration did not converge at the smallest increment.
    Unbalanced {
        /// Unbalanced traction over the largest dynamic stress.
        share: f64,
        /// The smallest increment tried, s.
        step_s: f64,
    },
    /// A law refused the smallest increment.
    Law(Refusal),
    /// The equations became singular.
    Singular,
    /// The base motion is empty, has no step, or holds a value that is not finite.
    Input(String),
    /// Whoever receives the frames could not.
    Sink(Box<Error>),
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "the column stopped at {:.4} s, {:.2} m deep: ", self.time_s, self.depth_m)?;
        match &self.cause {
            Cause::Unbalanced { share, step_s } => {
                write!(f, "{share:.1e} of the dynamic stress stays unbalanced at an increment of {step_s:.1e} s")
            }
            Cause::Law(refusal) => write!(f, "{refusal}"),
            Cause::Singular => f.write_str("the tangent stiffness is singular"),
            Cause::Input(what) => f.write_str(what),
            Cause::Sink(error) => write!(f, "{}", error.what()),
        }
    }
}

impl std::error::Error for Failure {}

impl From<Failure> for Error {
    fn from(failure: Failure) -> Self {
        match failure.cause {
            Cause::Sink(error) => *error,
            _ => Self::new(failure.to_string())
                .hint("a smaller `analysis.max_step_s`, or a weaker base motion")
                .of_model(),
        }
    }
}
