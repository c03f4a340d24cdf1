//! The finite-element soil column: mesh, geostatic state, assembly, damping, time stepping, pore water.
