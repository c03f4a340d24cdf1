//! The exact words of what is said of wrong manifests, records and command lines.

#[test]
fn mistakes_are_told_in_these_words() {
    trycmd::TestCases::new().case("tests/messages/messages.md").env("NO_COLOR", "1");
}
