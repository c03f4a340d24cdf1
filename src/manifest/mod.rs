//! The site manifest: typed TOML, cross-field checks, every problem at once.
