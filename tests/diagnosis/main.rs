//! The diagnosis as a whole: its fast column against exact and nonlinear ones, and twins with a truth of their own.

mod fast_column;
mod support;
mod twins;
