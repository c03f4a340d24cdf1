//! Stage 2: the sensors reconstructed from the sparse encoder.

use maud::{Markup, html};

use super::content::{Content, Distill};
use super::figure::{Section, figure, legend, model_keys};
use super::traces::{self, Look};
use super::{losses, number, pretrain};

/// The section, if stage 2 has run.
pub(super) fn section(content: &Content) -> Option<Section> {
    let stage = content.distill.as_ref()?;
    let body = html! {
        p { "A second encoder learns to find the same latent state from the sensors alone, on simulations; the decoder and "
            "the latent dynamics stay as they are." }
        @if !stage.sensors.is_empty() { (sensors(stage)) }
        @if !stage.traces.is_empty() { (case(stage)) }
        (losses::losses(stage.losses.as_ref(), "stage 2"))
    };
    Some(Section { id: "stage-2", title: "Stage 2: sparse distillation".into(), entries: Vec::new(), body })
}

fn sensors(stage: &Distill) -> Markup {
    let medians: Vec<String> = stage
        .sensors
        .iter()
        .map(|s| format!("{} {} %", s.label, number::optional(number::median(s.values.iter().copied()), 1)))
        .collect();
    let caption = html! {
        "NRMSE of the reconstruction over the validation cases at each sensor (%). Medians: " (medians.join(", ")) "."
        (pretrain::band_words(stage.published_range_percent))
    };
    let picture =
        pretrain::sample_boxes(&stage.sensors, stage.published_range_percent, "Sensor", "NRMSE per validation case");
    figure(&picture, &caption)
}

fn case(stage: &Distill) -> Markup {
    let with_record = stage.traces.iter().any(|t| t.record.is_some());
    let keys = model_keys(
        with_record.then_some("Record"),
        stage.traces.iter().any(|t| t.fe.is_some()),
        stage.traces.iter().any(|t| t.flare_t.is_some()),
    );
    let look = Look {
        about: format!("for case {}", stage.case),
        strong_s: traces::strong_part(&stage.traces),
        periods_s: traces::period_range(&stage.traces),
    };
    html! {
        h3 { "Case " (stage.case) }
        (legend(&keys))
        figure {
            @for trace in &stage.traces { (traces::row(trace, &look, &html! {})) }
            figcaption { "Validation case " (stage.case) ": response at the sensors, finite elements (the target here) and "
                "reconstruction, the shaded part enlarged, and 5 % damped pseudo-acceleration spectra." }
        }
    }
}
