//! Which of the known words was meant.

/// The known word nearest to `word`, when it is near enough to be worth asking about.
pub(crate) fn nearest<'a>(word: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let word = word.to_lowercase();
    let near = |candidate: &&str| {
        // A key without its unit is the commonest slip.
        let is_start = word.len() >= 3 && candidate.starts_with(&word);
        let distance = if is_start { 1 } else { edits(&word, &candidate.to_lowercase()) };
        (distance <= 1 + word.chars().count() / 4).then_some(distance)
    };
    known.into_iter().filter_map(|candidate| Some((near(&candidate)?, candidate))).min().map(|(_, candidate)| candidate)
}

/// Fewest letters to insert, remove, replace or swap with their neighbour.
fn edits(from: &str, to: &str) -> usize {
    let (from, to): (Vec<char>, Vec<char>) = (from.chars().collect(), to.chars().collect());
    let mut rows: Vec<Vec<usize>> = vec![(0..=to.len()).collect()];
    for (i, a) in from.iter().enumerate() {
        let mut row = vec![i + 1];
        for (j, b) in to.iter().enumerate() {
            let mut least = (row[j] + 1).min(rows[i][j + 1] + 1).min(rows[i][j] + usize::from(a != b));
            if i > 0 && j > 0 && *a == to[j - 1] && from[i - 1] == *b {
                least = least.min(rows[i - 1][j - 1] + 1);
            }
            row.push(least);
        }
        rows.push(row);
    }
    rows[from.len()][to.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slips_are_understood_and_other_words_are_not() {
        let known = ["period_us", "compute_at_us", "mass_kg", "friction_n"];
        assert_eq!(nearest("perod_us", known), Some("period_us"));
        assert_eq!(nearest("Period_us", known), Some("period_us"));
        assert_eq!(nearest("preiod_us", known), Some("period_us"));
        assert_eq!(nearest("mass", known), Some("mass_kg"));
        assert_eq!(nearest("stiffness", known), None);
        assert_eq!(nearest("", known), None);
    }

    #[test]
    fn a_swap_is_one_edit() {
        assert_eq!(edits("ab", "ba"), 1);
        assert_eq!(edits("", "abc"), 3);
        assert_eq!(edits("kitten", "sitting"), 3);
    }
}
