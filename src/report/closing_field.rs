//! The field's measures before and after the correction: amplitudes, response spectra, intensities, scores and letters.

use maud::{Markup, html};

use super::closing_content::{Closing, Field, FieldRow, TransferRow};
use super::number;

/// Both tables, where there is something in them.
pub(super) fn field(closing: &Closing) -> Markup {
    html! {
        @if let Some(field) = &closing.field { (overview(field)) (by_band(field)) }
        @if !closing.transfer.is_empty() { (letters(&closing.transfer)) }
    }
}

fn overview(field: &Field) -> Markup {
    html! {
        div.scroll { table {
            caption {
                "The field's measures over the held-out events: root mean square of the bias of the ln Fourier amplitude in ten bands "
                "from 0.5 to 9.5 Hz and of the ln ratio of 5 % response spectra from 0.1 to 5 s, bias ± scatter of ln ratios "
                "(prediction over record), and the median of Anderson's score (below 4 poor, to 6 fair, to 8 good). The ceiling is "
                "what filters from training events reach; the other horizontal is the second component of the same record taken for "
                "a prediction."
            }
            thead { tr {
                th scope="col" { "Model" } th.n scope="col" { "ln Fourier" } th.n scope="col" { "ln PSA" } th.n scope="col" { "ln PGA" } th.n scope="col" { "ln PGV" } th.n scope="col" { "ln Arias" }
                th.n scope="col" { "ln D5–75" } th.n scope="col" { "ln D5–95" } th.n scope="col" { "Anderson" }
            } }
            tbody { @for row in &field.rows {
                tr {
                    td { (row.model) }
                    td.n { (number::optional(row.fourier_rms, 2)) } td.n { (number::optional(row.psa_rms, 2)) }
                    @for ratio in &row.ratios { td.n { (bias_sigma(*ratio)) } }
                    td.n { (number::optional(row.anderson, 1)) }
                }
            } }
        } }
    }
}

fn by_band(field: &Field) -> Markup {
    html! {
        details {
            summary { "Amplitudes and response spectra by band" }
            (bands("ln Fourier amplitude by band (Hz)", &field.fourier_bands_hz, field, |row| &row.fourier))
            (bands("ln PSA of 5 % by band (s)", &field.psa_bands_s, field, |row| &row.psa))
        }
    }
}

fn bands(title: &str, edges: &[[f64; 2]], field: &Field, of: fn(&FieldRow) -> &Vec<Option<[f64; 2]>>) -> Markup {
    html! {
        div.scroll { table {
            caption { (title) ": bias ± scatter over the held-out events." }
            thead { tr {
                th scope="col" { "Model" }
                @for [low, high] in edges { th.n scope="col" { (number::significant(*low)) "–" (number::significant(*high)) } }
            } }
            tbody { @for row in &field.rows { tr { td { (row.model) } @for value in of(row) { td.n { (bias_sigma(*value)) } } } } }
        } }
    }
}

fn bias_sigma(value: Option<[f64; 2]>) -> String {
    value.map_or("–".into(), |[bias, sigma]| format!("{} ± {}", number::fixed(bias, 2), number::fixed(sigma, 2)))
}

fn letters(rows: &[TransferRow]) -> Markup {
    html! {
        div.scroll { table {
            caption {
                "Transfer functions of all weak events after Thompson et al. (2012): scatter of the recorded one between events (L below "
                "0.35, H above) and correlation of its mean with the predicted one (G above 0.6, P below)."
            }
            thead { tr { th scope="col" { "Component" } th scope="col" { "Sensor" } th scope="col" { "Model" } th scope="col" { "Letters" } th.n scope="col" { "r" } th.n scope="col" { "σ" } th.n scope="col" { "Events" } } }
            tbody { @for row in rows {
                tr {
                    td { (row.component) } td { (row.sensor) } td { (row.model) } td { b { (row.letters) } }
                    td.n { (number::fixed(row.r, 2)) } td.n { (number::fixed(row.sigma, 2)) } td.n { (row.n_event) }
                }
            } }
        } }
    }
}
