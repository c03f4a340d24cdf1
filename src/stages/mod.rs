//! Stages: read inputs, call the domain, write outputs.
