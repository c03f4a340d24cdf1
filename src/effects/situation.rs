//! In which component and event of the array's history a column is shaken: what direction and ageing depend on.

/// Component and place in the history of the motion that shakes the column; the default belongs to no record.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Situation {
    /// Index in the manifest's `records.components`.
    pub component: Option<usize>,
    /// Events after the middle of the array's history (before it: negative); 14 events run from −6.5 to 6.5.
    pub order: Option<f64>,
}

impl Situation {
    /// The situation of `component` in `event`; `history` names **all** events of the array, held-out ones too, in any
    /// order: history runs by name.
    pub fn of<'a>(component: usize, event: &str, history: impl IntoIterator<Item = &'a str>) -> Self {
        let mut before = 0.0;
        let mut count = 0.0;
        for name in history {
            count += 1.0;
            if name < event {
                before += 1.0;
            }
        }
        Self { component: Some(component), order: Some(before - 0.5 * (count - 1.0)) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_history_runs_by_name_and_is_counted_from_its_middle() {
        let names = ["B", "A", "D", "C"];
        let order = |event| Situation::of(1, event, names).order;
        assert_eq!([order("A"), order("C"), order("D")], [Some(-1.5), Some(0.5), Some(1.5)]);
        assert_eq!(Situation::of(1, "A", names).component, Some(1));
        assert_eq!(Situation::of(0, "A", ["A"]).order, Some(0.0));
    }
}
