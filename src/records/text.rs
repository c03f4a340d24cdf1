//! The lines of a text file, numbers of fixed width in them, and errors that name the line.

use super::channel::Channel;
use crate::error::{Error, Result};

/// The lines of a file from one on.
pub struct Lines<'a> {
    lines: Vec<&'a str>,
    next: usize,
}

impl<'a> Lines<'a> {
    /// All lines of `text`.
    pub fn new(text: &'a str) -> Self {
        Self { lines: text.lines().collect(), next: 0 }
    }

    /// The line that comes next, without going on.
    pub fn peek(&self) -> Option<&'a str> {
        self.lines.get(self.next).copied()
    }

    /// The next line.
    ///
    /// # Errors
    /// When the file ends before it.
    pub fn take(&mut self) -> Result<&'a str> {
        let line = self.peek().ok_or_else(|| {
            let what = format!("the file ends after line {}, in the middle of a channel", self.next);
            Error::new(what).hint("download the file again; was it cut off?")
        })?;
        self.next += 1;
        Ok(line)
    }

    /// Leaves out empty lines.
    pub fn skip_empty(&mut self) {
        while self.peek().is_some_and(|line| line.trim().is_empty()) {
            self.next += 1;
        }
    }

    /// What `read` makes of the channels that follow one another to the end of the file; it gets their numbers from 1.
    ///
    /// # Errors
    /// That of the first channel with one.
    pub fn channels(
        mut self,
        mut read: impl FnMut(&mut Self, usize) -> Result<Option<Channel>>,
    ) -> Result<Vec<Channel>> {
        let mut found = Vec::new();
        loop {
            self.skip_empty();
            if self.peek().is_none() {
                return Ok(found);
            }
            found.extend(read(&mut self, found.len() + 1)?);
        }
    }

    /// `count` numbers in the next lines, `columns` a line of `width` characters each.
    ///
    /// # Errors
    /// When the file ends before them, or one is not a finite number.
    pub fn numbers(&mut self, count: usize, layout: Layout) -> Result<Vec<f64>> {
        let mut found = Vec::with_capacity(count.min(1 << 20));
        while found.len() < count {
            let line = self.take()?;
            let wanted = layout.columns.min(count - found.len());
            for i in 0..wanted {
                let field = line.get(i * layout.width..).map(|rest| rest.get(..layout.width).unwrap_or(rest));
                found.push(self.number_in(field.unwrap_or("").trim())?);
            }
        }
        Ok(found)
    }

    fn number_in(&self, text: &str) -> Result<f64> {
        // Fortran writes exponents of double precision with a D.
        let value = text.parse::<f64>().or_else(|_| text.replace(['D', 'd'], "E").parse());
        value.ok().filter(|v| v.is_finite()).ok_or_else(|| self.wrong("a number", text))
    }

    /// That the line taken last does not hold what is `needed`.
    pub fn wrong(&self, needed: &str, got: &str) -> Error {
        Error::new(format!("line {} must hold {needed}, got `{}`", self.next, shown(got)))
            .hint("the file is damaged, or is not of this format: download it again")
    }
}

/// Fields of fixed width.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Layout {
    /// Numbers a line.
    pub columns: usize,
    /// Characters a number.
    pub width: usize,
}

impl Layout {
    /// The layout that a Fortran format such as `(8f10.6)` states.
    pub fn stated_in(line: &str) -> Option<Self> {
        let format = &line[line.rfind('(')? + 1..];
        let format = format.split([')', '.']).next()?;
        // A scale factor such as `1P` may come before the fields.
        let format = format.rsplit(['P', 'p', ',']).next()?.trim();
        let letter = format.find(|c: char| c.is_ascii_alphabetic())?;
        let columns = if letter == 0 { 1 } else { format[..letter].trim().parse().ok()? };
        let width = format[letter + 1..].trim().parse().ok()?;
        ((1..=1000).contains(&columns) && (1..=100).contains(&width)).then_some(Self { columns, width })
    }
}

/// The number a text starts with: `100Hz` gives 100.
pub fn leading_number(text: &str) -> Option<f64> {
    let text = text.trim_start();
    let end = text.find(|c: char| !(c.is_ascii_digit() || ".+-eE".contains(c))).unwrap_or(text.len());
    let end = (0..=end).rev().find(|&end| text[..end].parse::<f64>().is_ok())?;
    text[..end].parse().ok().filter(|v: &f64| v.is_finite())
}

/// The start of a text for a message.
pub fn shown(text: &str) -> String {
    text.chars().take(40).filter(|c| !c.is_control()).collect()
}
