//! Thinning of curves and fields to what a screen can show, without losing a peak.

/// At most about `2 × buckets` points of a curve: the smallest and the largest value of each of `buckets` equal spans of
/// the index, in their order, together with the first and the last point. Pieces between non-finite values stay apart.
pub(super) fn curve(points: &[(f64, f64)], buckets: usize) -> Vec<Vec<(f64, f64)>> {
    let per_bucket = points.len().div_ceil(buckets.max(1)).max(1);
    points
        .split(|(x, y)| !x.is_finite() || !y.is_finite())
        .filter(|piece| piece.len() > 1)
        .map(|piece| if per_bucket <= 2 { piece.to_vec() } else { extremes(piece, per_bucket) })
        .collect()
}

fn extremes(piece: &[(f64, f64)], per_bucket: usize) -> Vec<(f64, f64)> {
    let mut kept = vec![piece[0]];
    let mut push = |point: (f64, f64)| {
        if kept.last() != Some(&point) {
            kept.push(point);
        }
    };
    for bucket in piece.chunks(per_bucket) {
        let by_value = |a: &&(f64, f64), b: &&(f64, f64)| a.1.total_cmp(&b.1);
        if let (Some(&low), Some(&high)) = (bucket.iter().min_by(by_value), bucket.iter().max_by(by_value)) {
            let (first, second) = if low.0 <= high.0 { (low, high) } else { (high, low) };
            push(first);
            push(second);
        }
    }
    push(piece[piece.len() - 1]);
    kept
}

/// A matrix `[row][column]` averaged over blocks so that it has at most `rows × columns` entries.
pub(super) fn block_mean(matrix: &[Vec<f64>], rows: usize, columns: usize) -> Vec<Vec<f64>> {
    let n_column = matrix.first().map_or(0, Vec::len);
    let tall = matrix.len().div_ceil(rows.max(1)).max(1);
    let wide = n_column.div_ceil(columns.max(1)).max(1);
    matrix
        .chunks(tall)
        .map(|block| {
            (0..n_column)
                .step_by(wide)
                .map(|start| {
                    let end = (start + wide).min(n_column);
                    let sum: f64 = block.iter().flat_map(|row| &row[start..end]).sum();
                    sum / (block.len() * (end - start)) as f64
                })
                .collect()
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thinning_keeps_both_peaks_and_both_ends() {
        let mut points: Vec<(f64, f64)> = (0..10_000).map(|i| (f64::from(i), (f64::from(i) * 0.37).sin())).collect();
        points[4_321].1 = 9.0;
        points[7_777].1 = -7.0;
        let thin = curve(&points, 300).remove(0);
        assert!(thin.len() <= 602, "{}", thin.len());
        assert!(thin.contains(&(4_321.0, 9.0)) && thin.contains(&(7_777.0, -7.0)));
        assert_eq!((thin[0], thin[thin.len() - 1]), (points[0], points[9_999]));
        assert!(thin.windows(2).all(|w| w[0].0 <= w[1].0));
    }

    #[test]
    fn short_curves_pass_unchanged_and_gaps_split_them() {
        let points = vec![(0.0, 1.0), (1.0, 2.0), (2.0, f64::NAN), (3.0, 4.0), (4.0, 5.0)];
        assert_eq!(curve(&points, 100), vec![vec![(0.0, 1.0), (1.0, 2.0)], vec![(3.0, 4.0), (4.0, 5.0)]]);
    }

    #[test]
    fn block_mean_keeps_the_total_of_whole_blocks() {
        let matrix: Vec<Vec<f64>> = (0..4).map(|i| (0..6).map(|j| f64::from(i * 6 + j)).collect()).collect();
        assert_eq!(block_mean(&matrix, 2, 3), vec![vec![3.5, 5.5, 7.5], vec![15.5, 17.5, 19.5]]);
        assert_eq!(block_mean(&matrix, 10, 10), matrix);
    }
}
