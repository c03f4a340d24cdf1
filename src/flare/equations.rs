//! Latent equations as text.

use super::library::Library;

/// One line a latent equation, coefficients in 1/s, zero terms left out: `dz1/dt = -0.31 z1 + 2.4 u`.
pub fn equations(library: Library, coefficients_per_s: &[f64]) -> Vec<String> {
    let names = library.names();
    (0..library.latent)
        .map(|k| {
            let mut line = format!("dz{}/dt =", k + 1);
            let kept =
                names.iter().zip(coefficients_per_s.chunks_exact(library.latent)).filter(|(_, row)| row[k] != 0.0);
            for (i, (name, row)) in kept.enumerate() {
                let sign = match (row[k] < 0.0, i) {
                    (true, 0) => " -",
                    (true, _) => " - ",
                    (false, 0) => " ",
                    (false, _) => " + ",
                };
                let term = if name == "1" { String::new() } else { format!(" {name}") };
                line += &format!("{sign}{}{term}", significant(row[k].abs()));
            }
            if line.ends_with('=') { line + " 0" } else { line }
        })
        .collect()
}

/// Four significant digits without an exponent for ordinary sizes.
fn significant(value: f64) -> String {
    let digits = (3.0 - value.log10().floor()).clamp(0.0, 8.0) as usize;
    format!("{value:.digits$}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equations_print_with_signs_names_and_without_removed_terms() {
        let library = Library { latent: 2, memories: 0, energies: 0 };
        let mut xi = vec![0.0; library.n_coefficient()];
        xi[0] = -0.25; // 1 in dz1
        xi[2] = 1.5; // z1 in dz1
        xi[4 * 2] = -12.345678; // z1 z2 in dz1
        assert_eq!(equations(library, &xi), ["dz1/dt = -0.2500 + 1.500 z1 - 12.35 z1 z2", "dz2/dt = 0"]);
    }
}
