//! The report in a real browser, where one is installed: on a screen, on a phone, in the dark and on paper.

mod report_sample;

use serde::Deserialize;
use std::path::Path;
use std::process::{Command, Output};

#[path = "support/python.rs"]
mod python;

/// Names under which the browser is installed.
const BROWSERS: [&str; 4] = ["chromium", "chromium-browser", "google-chrome", "google-chrome-stable"];

fn browser() -> Option<&'static str> {
    let found = BROWSERS
        .into_iter()
        .find(|name| Command::new(name).arg("--version").output().is_ok_and(|out| out.status.success()));
    if found.is_none() {
        eprintln!("skipped: no Chromium or Chrome on the PATH, so the report was not opened in a browser");
    }
    found
}

fn open(browser: &str, folder: &Path, page: &Path, arguments: &[&str]) -> Output {
    let out = Command::new(browser)
        .args(["--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--hide-scrollbars"])
        .args(["--disable-background-networking", "--disable-component-update", "--disable-sync"])
        .args(["--enable-logging=stderr", "--v=0", "--virtual-time-budget=5000"])
        .arg(format!("--user-data-dir={}", folder.join("profile").display()))
        .args(arguments)
        .arg(format!("file://{}", page.display()))
        .output()
        .unwrap();
    let log = String::from_utf8_lossy(&out.stderr);
    assert!(out.status.success(), "{log}");
    let complaints: Vec<&str> = log.lines().filter(|line| line.contains("CONSOLE")).collect();
    assert!(complaints.is_empty(), "{complaints:?}");
    out
}

/// What the page says of itself.
#[derive(Debug, Deserialize)]
struct Seen {
    width: f64,
    scroll: f64,
    figures: usize,
    empty: Vec<String>,
    overlapping: Vec<String>,
    small: Vec<String>,
    headings: Vec<u8>,
    heads_without_scope: usize,
    contrast: f64,
    curves: [usize; 2],
    beyond: Vec<String>,
}

/// Looks at every figure and heading, and takes one box off.
const LOOK: &str = include_str!("report_sample/look.js");

/// A page as narrow as a phone, which no window of the browser is.
fn on_phone(html: &str) -> String {
    let inner = html.replace('&', "&amp;").replace('"', "&quot;");
    format!(
        "<!DOCTYPE html><iframe width=\"390\" height=\"844\" style=\"border:0\" srcdoc=\"{inner}\"></iframe><script>\
         addEventListener('message', m => {{ const out = document.createElement('pre'); out.id = 'seen'; \
         out.textContent = m.data; document.body.append(out); }});</script>"
    )
}

fn seen(browser: &str, html: &str, is_phone: bool, arguments: &[&str]) -> Seen {
    let folder = tempfile::tempdir().unwrap();
    let page = folder.path().join("report.html");
    // The page forbids scripts; the copy that is looked at does not.
    let policy = html.find("<meta http-equiv=\"Content-Security-Policy\"").expect("a policy");
    let end = policy + html[policy..].find('>').expect("the policy ends") + 1;
    let looked_at = format!("{}{}<script>{LOOK}</script>", &html[..policy], &html[end..]);
    std::fs::write(&page, if is_phone { on_phone(&looked_at) } else { looked_at }).unwrap();
    let out = open(browser, folder.path(), &page, &[&["--dump-dom"], arguments].concat());
    let dom = String::from_utf8_lossy(&out.stdout);
    let text = dom.rsplit("<pre id=\"seen\">").next().expect("the page was looked at").split("</pre>").next().unwrap();
    serde_json::from_str(&text.replace("&amp;", "&").replace("&lt;", "<").replace("&gt;", ">")).unwrap()
}

#[test]
fn a_browser_shows_every_section_without_complaint() {
    let Some(browser) = browser() else { return };
    let folder = tempfile::tempdir().unwrap();
    let page = folder.path().join("report.html");
    let common = ["summary", "loop", "loop-errors", "loop-candidates", "loop-rest", "held-out", "event-6", "scores"];
    let stages = ["stage-1", "stage-2", "stage-3", "stage-3-2", "motions", "provenance"];
    let closed = ["site", "depth", "events-table", "spectra", "transfer", "residual"];
    for (content, more) in [(report_sample::content(), &[][..]), (report_sample::closed(), &closed[..])] {
        std::fs::write(&page, report_sample::page(&content, report_sample::COMMAND)).unwrap();
        let out = open(browser, folder.path(), &page, &["--dump-dom"]);
        let dom = String::from_utf8_lossy(&out.stdout);
        for id in common.iter().chain(&stages).chain(more) {
            assert!(dom.contains(&format!("id=\"{id}\"")), "section `{id}` is missing");
        }
        // Figures must survive HTML parsing inside the page, none cut off or moved out of its figure.
        assert_eq!(dom.matches("<svg").count(), dom.matches("</svg>").count());
        assert!(dom.matches("<svg").count() > 60);
        assert!(dom.trim_end().ends_with("</html>"));
    }
}

#[test]
fn figures_are_whole_and_legible_on_every_screen() {
    let Some(browser) = browser() else { return };
    let html = report_sample::page(&report_sample::closed(), report_sample::COMMAND);
    for (what, is_phone, arguments) in
        [("light", false, &[][..]), ("dark", false, &["--blink-settings=preferredColorScheme=0"]), ("phone", true, &[])]
    {
        let seen = seen(browser, &html, is_phone, &[&["--window-size=1280,900"], arguments].concat());
        println!("{what}: {} figures, {} of {} px wide", seen.figures, seen.scroll, seen.width);
        assert!(seen.figures > 60, "{}", seen.figures);
        assert!(seen.empty.is_empty(), "{what}: empty {:?}", seen.empty);
        assert!(seen.overlapping.is_empty(), "{what}: {:#?}", seen.overlapping);
        assert!(seen.scroll <= seen.width, "{what}: {} px in {}: {:?}", seen.scroll, seen.width, seen.beyond);
        assert_eq!(seen.width < 500.0, is_phone);
        assert!(seen.small.is_empty(), "{what}: {:#?}", seen.small);
        assert!(seen.contrast > 7.0, "{what}: {}", seen.contrast);
        assert_eq!(seen.heads_without_scope, 0);
        assert!(seen.headings.windows(2).all(|w| w[1] <= w[0] + 1), "{:?}", seen.headings);
        assert!(seen.curves[1] < seen.curves[0], "a box without its mark hides curves: {:?}", seen.curves);
    }
}

#[test]
fn all_of_it_is_printed() {
    let Some(browser) = browser() else { return };
    let Some(python) = python::python("pypdf", "import pypdf", &["pypdf"]) else { return };
    let folder = tempfile::tempdir().unwrap();
    let [page, pdf] = ["report.html", "report.pdf"].map(|name| folder.path().join(name));
    let content = report_sample::closed();
    std::fs::write(&page, report_sample::page(&content, report_sample::COMMAND)).unwrap();
    open(browser, folder.path(), &page, &[&format!("--print-to-pdf={}", pdf.display())]);
    let code = "import sys, pypdf; print(chr(12).join(p.extract_text() for p in pypdf.PdfReader(sys.argv[1]).pages))";
    let out = Command::new(python).args(["-c", code]).arg(&pdf).output().unwrap();
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    let text = String::from_utf8_lossy(&out.stdout).split_whitespace().collect::<Vec<_>>().join(" ");
    println!("{} pages", text.matches('\u{c}').count() + 1);
    for event in &content.events {
        assert!(text.contains(&format!("{} {}", event.event, event.component)), "{} is not printed", event.event);
    }
    // Each event prints its table of peaks, those that are closed on the screen too.
    let tables = text.matches("FE as declared").count();
    assert!(tables >= 3 * content.events.len(), "{tables} tables of {} events", content.events.len());
    assert!(text.contains("The manifest as it was run") && text.contains("FLARE-T after"));
}
