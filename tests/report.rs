//! The report as a document: well-formed, self-contained, deterministic, safe with hostile names, graceful with gaps.

mod report_sample;

use flare_pipe::report::{self, Content, content::*};

/// Elements that have no end tag in HTML.
const VOID: [&str; 4] = ["meta", "link", "br", "input"];

/// Walks all tags and panics at the first one that is not closed in order; returns the names of all elements.
fn elements(html: &str) -> Vec<String> {
    let mut open: Vec<String> = Vec::new();
    let mut seen = Vec::new();
    let mut rest = html;
    while let Some(start) = rest.find('<') {
        rest = &rest[start..];
        if rest.starts_with("<!") {
            rest = &rest[rest.find('>').expect("a declaration ends")..];
            continue;
        }
        let mut quoted = false;
        let end = rest
            .char_indices()
            .find(|&(_, c)| {
                quoted ^= c == '"';
                c == '>' && !quoted
            })
            .map(|(i, _)| i)
            .expect("every tag ends");
        let tag = &rest[1..end];
        rest = &rest[end + 1..];
        if let Some(name) = tag.strip_prefix('/') {
            assert_eq!(open.pop().as_deref(), Some(name), "closing tag out of order");
            continue;
        }
        let name = tag.split([' ', '/']).next().unwrap_or_default().to_owned();
        assert!(!name.is_empty() && name.bytes().all(|b| b.is_ascii_alphanumeric()), "odd tag `<{tag}>`");
        if !tag.ends_with('/') && !VOID.contains(&name.as_str()) {
            open.push(name.clone());
        }
        if name == "style" {
            rest = &rest[rest.find("</style>").expect("style ends")..];
        }
        seen.push(name);
    }
    assert!(open.is_empty(), "left open: {open:?}");
    seen
}

#[test]
fn the_whole_report_is_balanced_and_small() {
    let html = report::render(&report_sample::content()).unwrap();
    let seen = elements(&html);
    assert!(seen.iter().filter(|name| *name == "svg").count() > 60);
    assert!(html.len() < 6_000_000, "{} bytes", html.len());
    println!("{} bytes", html.len());
}

#[test]
fn a_closed_loop_shows_the_site_and_every_model_at_every_event() {
    let content = report_sample::closed();
    let html = report::render(&content).unwrap();
    elements(&html);
    assert!(html.len() < 8_000_000, "{} bytes", html.len());
    for part in [
        "FE as declared",
        "FE recalibrated",
        "FE corrected",
        "FLARE-T before",
        "FLARE-T after",
        "Vs30",
        "Soil column of 17 m",
    ] {
        let is_there = html.contains(part);
        assert_eq!(is_there, part != "Vs30", "`{part}`");
    }
    // A runaway model, an absent one and an event without sensors leave gaps and no panic.
    let mut odd = content.clone();
    odd.events[0].sensors[0].models[2].history.values.fill(f64::NAN);
    odd.events[0].sensors[0].models[3].psa_m_s2.fill(f64::INFINITY);
    odd.events[1].sensors.clear();
    odd.events[2].sensors[1].models.retain(|m| m.model != "record");
    odd.events[3].input.values.clear();
    odd.transfers[0].recorded_ln.fill(f64::NAN);
    odd.residuals[0].models.clear();
    odd.depth.as_mut().unwrap().models[0].stress_strain.clear();
    odd.depth.as_mut().unwrap().models[1].strain_percent.fill(f64::NAN);
    odd.site_view.as_mut().unwrap().layers.clear();
    elements(&report::render(&odd).unwrap());
}

#[test]
fn nothing_is_loaded_from_elsewhere_and_nothing_runs() {
    let html = report::render(&report_sample::closed()).unwrap();
    for forbidden in ["http:", "https:", "//cdn", "<script", "<iframe", "<object", "@import", "url(", " onload", "<img"]
    {
        assert!(!html.contains(forbidden), "found `{forbidden}`");
    }
    let inside = ["#", "data:,", "data:image/bmp;base64,"];
    let links: Vec<&str> = html.split("href=\"").skip(1).map(|s| &s[..s.find('"').unwrap()]).collect();
    assert!(links.iter().all(|l| inside.iter().any(|known| l.starts_with(known))));
}

#[test]
fn every_entry_of_the_contents_has_its_target_and_ids_are_unique() {
    for content in [report_sample::content(), report_sample::closed()] {
        targets(&report::render(&content).unwrap());
    }
}

fn targets(html: &str) {
    let mut ids: Vec<&str> = html.split(" id=\"").skip(1).map(|s| &s[..s.find('"').unwrap()]).collect();
    for link in html.split("href=\"#").skip(1).map(|s| &s[..s.find('"').unwrap()]) {
        assert!(ids.contains(&link), "no target `{link}`");
    }
    let n = ids.len();
    ids.sort_unstable();
    ids.dedup();
    assert_eq!(ids.len(), n, "ids repeat");
}

#[test]
fn the_same_content_gives_the_same_bytes() {
    let content = report_sample::closed();
    let first = report::render(&content).unwrap();
    let thread = std::thread::spawn(move || report::render(&content).unwrap());
    assert!(first == thread.join().unwrap());
}

#[test]
fn a_page_says_how_it_was_run() {
    let content = report_sample::closed();
    let page = report_sample::page(&content, report_sample::COMMAND);
    for part in [report_sample::COMMAND, "2026-11-30 04:23 UTC", "LSST07.EW.csv", "with changes"] {
        assert!(page.contains(part), "{part}");
    }
    // The page itself holds nothing that may differ between two runs.
    assert!(!report::render(&content).unwrap().contains("UTC"));
}

#[test]
fn content_survives_json() {
    let content = report_sample::closed();
    let text = serde_json::to_string(&content).unwrap();
    assert!(serde_json::from_str::<Content>(&text).unwrap() == content);
}

#[test]
fn hostile_names_stay_text() {
    let evil = "<script>alert(1)</script>\"'&<b>\u{0}$x^2$";
    let mut content = report_sample::closed();
    content.site = evil.into();
    content.description = vec![evil.into()];
    content.notices = vec![evil.into()];
    content.provenance.manifest = evil.into();
    content.provenance.facts = vec![(evil.into(), evil.into())];
    for prediction in &mut content.held_out {
        prediction.event = evil.into();
        prediction.component = evil.into();
        prediction.traces.iter_mut().for_each(|t| t.sensor = evil.into());
        prediction.timewise_percent.iter_mut().for_each(|t| t.sensor = evil.into());
    }
    for event in &mut content.events {
        event.event = evil.into();
        event.component = evil.into();
        event.sensors.iter_mut().for_each(|s| s.sensor = evil.into());
    }
    content.transfers[0].sensor = evil.into();
    content.residuals[0].sensor = evil.into();
    let site = content.site_view.as_mut().unwrap();
    site.sensors[1].name = evil.into();
    site.layers[1].law = evil.into();
    site.facts = vec![(evil.into(), evil.into())];
    site.events[0].event = evil.into();
    for score in &mut content.scores {
        score.event = evil.into();
        score.sensor = evil.into();
    }
    let stage = content.pretrain.as_mut().unwrap();
    stage.field.as_mut().unwrap().case = evil.into();
    stage.cases[0].label = evil.into();
    stage.losses.as_mut().unwrap().counter = evil.into();
    stage.losses.as_mut().unwrap().terms[0].name = evil.into();
    content.calibrate[0].component = evil.into();
    content.calibrate[0].terms[3] = evil.into();
    let html = report_sample::page(&content, evil);
    assert!(!html.contains("<script") && !html.contains("\"'&<"));
    assert!(!elements(&html).iter().any(|name| name == "script"));
}

#[test]
fn absent_parts_disappear_with_their_entries() {
    let html = report::render(&Content { site: "bare".into(), ..Content::default() }).unwrap();
    let seen = elements(&html);
    assert_eq!(seen.iter().filter(|name| *name == "section").count(), 1);
    assert!(!html.contains("stage-1") && !html.contains("<figure") && !html.contains("NaN"));
}

#[test]
fn a_diverged_prediction_is_cut_and_said_and_counted() {
    let mut content = report_sample::content();
    let values = &mut content.held_out[0].traces[0].flare_t.as_mut().unwrap().values;
    for (i, v) in values.iter_mut().enumerate().skip(300) {
        *v = if i < 400 { 1e12 } else { f64::NAN };
    }
    content.held_out[0].timewise_percent[0].flare_t = vec![f64::NAN; 10];
    content.held_out[0].traces[0].spectrum.as_mut().unwrap().flare_t_m_s2.fill(f64::INFINITY);
    content.scores[0].nrmse_percent.flare_t = None;
    let html = report::render(&content).unwrap();
    elements(&html);
    assert!(html.contains("At DHB11 a prediction leaves the figure"));
    assert!(html.contains("gave no finite prediction: 1 of 18"));
    assert!(!html.contains("NaN") && !html.contains("inf"), "a number leaked");
}

#[test]
fn degenerate_data_does_not_break_the_page() {
    let flat = Series { start_s: 0.0, step_s: 0.05, values: vec![0.0; 40] };
    let mut content = report_sample::content();
    let trace = &mut content.held_out[0].traces[0];
    (trace.record, trace.fe, trace.flare_t) = (Some(flat.clone()), Some(flat), None);
    content.held_out[1].traces[0].record.as_mut().unwrap().values.clear();
    content.held_out[2].traces[0].spectrum = Some(Spectrum::default());
    content.held_out[3].timewise_percent[0].fe.clear();
    let stage = content.pretrain.as_mut().unwrap();
    stage.cases[1].values.clear();
    stage.cases[2].values = vec![5.0];
    let field = stage.field.as_mut().unwrap();
    field.fe_m_s2.fill(0.0);
    field.model_m_s2.fill(f32::NAN);
    content.calibrate[0].before.iter_mut().flatten().for_each(|v| *v = 0.0);
    content.calibrate[1].terms.clear();
    content.calibrate[1].before.clear();
    content.calibrate[1].after.clear();
    let html = report::render(&content).unwrap();
    elements(&html);
    assert!(!html.contains("NaN") && !html.contains("inf\""), "a number leaked");
}

#[test]
fn arrays_that_do_not_fit_are_refused_with_their_place() {
    let mut content = report_sample::content();
    content.pretrain.as_mut().unwrap().field.as_mut().unwrap().fe_m_s2.pop();
    let message = report::render(&content).unwrap_err().to_string();
    assert!(message.contains("59999 values do not fit 100 depths") && message.contains("case `081`"), "{message}");

    let mut content = report_sample::content();
    content.held_out[1].traces[2].spectrum.as_mut().unwrap().fe_m_s2.pop();
    let message = report::render(&content).unwrap_err().to_string();
    assert!(message.contains("99 spectral values do not fit 100 periods") && message.contains("`FA1-5`"), "{message}");

    let mut content = report_sample::content();
    content.held_out[0].traces[0].record.as_mut().unwrap().step_s = 0.0;
    assert!(report::render(&content).unwrap_err().to_string().contains("must be positive, got 0 s"));
}
