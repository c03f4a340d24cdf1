//! How long work tells of its progress without knowing who listens (a terminal, a log, nobody).

/// Receives progress of one piece of work counted in steps.
pub trait Progress: Sync {
    /// Announces `total` steps of `what`.
    fn start(&self, what: &str, total: u64);
    /// `steps` more are done.
    fn advance(&self, steps: u64);
    /// A short remark for the log and beside the bar ("validation 12.3 %").
    fn note(&self, text: &str);
    /// A remark that people should see however little they asked to be told.
    fn warn(&self, text: &str) {
        self.note(text);
    }
}

/// Listens to nothing.
pub struct Quiet;

impl Progress for Quiet {
    fn start(&self, _: &str, _: u64) {}
    fn advance(&self, _: u64) {}
    fn note(&self, _: &str) {}
}
