//! Cached, resumable stages on a directed acyclic graph; knows nothing of soil.
