//! Loss histories: named columns, one row an epoch, as CSV.

/// A table of numbers over the epochs. A cell that was not computed is no number and stays empty in the file.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct History {
    /// Names of the columns, `epoch` first.
    pub columns: Vec<String>,
    /// One row an epoch.
    pub rows: Vec<Vec<f64>>,
}

impl History {
    /// An empty table.
    pub fn new(columns: &[&str]) -> Self {
        Self { columns: columns.iter().map(|c| (*c).to_string()).collect(), rows: Vec::new() }
    }

    /// The values of a column, or nothing if there is no such column.
    pub fn column(&self, name: &str) -> Option<Vec<f64>> {
        let at = self.columns.iter().position(|c| c == name)?;
        Some(self.rows.iter().map(|row| row[at]).collect())
    }

    /// The table as CSV with a header.
    pub fn to_csv(&self) -> String {
        let mut text = self.columns.join(",") + "\n";
        for row in &self.rows {
            let cells: Vec<String> =
                row.iter().map(|v| if v.is_nan() { String::new() } else { v.to_string() }).collect();
            text += &(cells.join(",") + "\n");
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_that_were_not_computed_stay_empty() {
        let mut history = History::new(&["epoch", "loss"]);
        history.rows.push(vec![1.0, 0.5]);
        history.rows.push(vec![2.0, f64::NAN]);
        assert_eq!(history.to_csv(), "epoch,loss\n1,0.5\n2,\n");
        assert_eq!(history.column("loss").map(|c| c[0]), Some(0.5));
    }
}
