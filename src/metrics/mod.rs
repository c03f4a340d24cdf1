//! Measures of agreement between a prediction and a record.
