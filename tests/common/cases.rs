//! How many cases tests of properties try.

use proptest::test_runner::{Config, RngSeed};

/// So many cases, drawn alike in each run and on each machine. `PROPTEST_RNG_SEED` names other ones.
pub fn cases(count: u32) -> Config {
    let plain = Config::default();
    let rng_seed = match plain.rng_seed {
        RngSeed::Random => RngSeed::Fixed(1),
        chosen => chosen,
    };
    Config { cases: count, rng_seed, failure_persistence: None, ..plain }
}
