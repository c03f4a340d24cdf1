//! Named random streams: the same seed and label give the same numbers on every machine and thread count.

use rand_chacha::ChaCha12Rng;
use rand_chacha::rand_core::SeedableRng;

/// A ChaCha12 stream for `label` under `seed`; different labels are independent.
pub fn stream(seed: u64, label: &str) -> ChaCha12Rng {
    let mut hash = blake3::Hasher::new_derive_key("flare-pipe random stream v1");
    hash.update(&seed.to_le_bytes());
    hash.update(label.as_bytes());
    ChaCha12Rng::from_seed(*hash.finalize().as_bytes())
}
