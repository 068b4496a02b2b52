//! The shipped suite, as `stemgen validate` runs it.

use stemgen::progress::Progress;
use stemgen::validate::Verdict;
use stemgen::validate::suite::{Case, cases};

/// Counts what is reported.
#[derive(Default)]
struct Counter(std::sync::atomic::AtomicU64);

impl Progress for Counter {
    fn start(&self, _: &str, _: &str, _: u64) {
        panic!("a case starts no stage of its own");
    }
    fn advance(&self, n: u64) {
        self.0.fetch_add(n, std::sync::atomic::Ordering::Relaxed);
    }
    fn finish(&self) {
        panic!("nor does it end one");
    }
    fn warn(&self, _: &str) {}
    fn interrupted(&self) -> bool {
        false
    }
}

/// The cases pass, and the progress bar of quick ones reaches its end, and not before.
fn run(wanted: fn(&Case) -> bool) {
    let mut failed = Vec::new();
    for case in cases().into_iter().filter(wanted) {
        let counter = Counter::default();
        let outcome = case.run(&counter).unwrap();
        let counted = counter.0.into_inner();
        assert!(!case.quick || counted == case.units(), "{}: {counted} units", case.name);
        println!("{}: {:.1} s, {:.1} expected", case.name, outcome.wall_time_s, case.seconds);
        for check in &outcome.checks {
            println!("    {}: {:.6} {} {:?}", check.what, check.value, check.unit, check.limit);
        }
        assert!(!outcome.checks.is_empty(), "{}", case.name);
        if outcome.verdict != Verdict::Pass {
            failed.push(outcome);
        }
    }
    let names: Vec<&str> = failed.iter().map(|o| o.name.as_str()).collect();
    assert!(failed.is_empty(), "{names:?}");
}

#[test]
#[ignore = "long"]
fn quick_cases_pass() {
    run(|c| c.quick);
}

#[test]
#[ignore = "long"]
fn other_cases_pass() {
    run(|c| !c.quick);
}
