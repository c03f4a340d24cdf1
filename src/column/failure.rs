//! Why a column could not finish a motion.

use crate::soil::Refusal;
use std::fmt;

/// A run that ended before its motion did.
#[derive(Debug)]
pub struct Failure {
    /// Time reached, s.
    pub time_s: f64,
    /// Depth of the trouble, m, where it has one.
    pub depth_m: Option<f64>,
    /// What went wrong.
    pub cause: Cause,
}

/// What went wrong.
#[derive(Debug)]
pub enum Cause {
    /// Newton did not converge at the smallest step: out-of-balance force over the force scale.
    NoConvergence {
        /// Step, s.
        step_s: f64,
        /// Out-of-balance force over the force scale.
        residual: f64,
    },
    /// A law refused even the smallest step.
    Law(Refusal),
    /// The tangent matrix became singular.
    Singular,
    /// The base motion is empty or holds a value that is not finite.
    BaseMotion,
    /// Whoever takes the output could not.
    Output(crate::Error),
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.cause {
            Cause::NoConvergence { step_s, residual } => {
                write!(f, "Newton does not converge at the smallest step {step_s:.1e} s (residual {residual:.1e})")?;
            }
            Cause::Law(refusal) => write!(f, "{refusal}")?,
            Cause::Singular => write!(f, "the tangent matrix is singular")?,
            Cause::BaseMotion => write!(f, "the base motion is empty or not finite")?,
            Cause::Output(error) => write!(f, "{error}")?,
        }
        write!(f, " at t = {:.4} s", self.time_s)?;
        match self.depth_m {
            Some(depth) => write!(f, ", depth {depth:.2} m"),
            None => Ok(()),
        }
    }
}

impl std::error::Error for Failure {}
