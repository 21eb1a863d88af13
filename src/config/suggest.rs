//! Suggestion of the known word that was probably meant.

use std::path::Path;

/// Returns the known word nearest to `word`, if it is near enough for a suggestion.
pub fn nearest<'a>(word: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let word = word.to_lowercase();
    let near = |candidate: &&str| {
        // A key without its unit is the commonest slip.
        let is_start = word.len() >= 3 && candidate.starts_with(&word);
        let distance = if is_start { 1 } else { edits(&word, &candidate.to_lowercase()) };
        // Words that share less than three quarters of their letters are not each other's slip, nor are words of two letters.
        let letters = word.chars().count();
        (letters > 2 && distance <= (letters / 4).max(1)).then_some(distance)
    };
    known.into_iter().filter_map(|candidate| Some((near(&candidate)?, candidate))).min().map(|(_, candidate)| candidate)
}

/// Returns the file whose name is nearest to that of a path. Folders and extensions do not count, since their names may be alike
/// by chance.
pub(super) fn nearest_file<'a>(path: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let stem = |path: &'a str| (Path::new(path).file_stem().and_then(|stem| stem.to_str()).unwrap_or(path), path);
    let known: Vec<(&str, &str)> = known.into_iter().map(stem).collect();
    let asked = Path::new(path).file_stem().and_then(|stem| stem.to_str())?;
    let meant = nearest(asked, known.iter().map(|(stem, _)| *stem))?;
    known.into_iter().find(|(stem, _)| *stem == meant).map(|(_, path)| path)
}

/// Returns the smallest number of letters to insert, remove, replace or swap with their neighbour.
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
        assert_eq!(nearest("mess_kg", known), Some("mass_kg"));
        for (word, known) in [("maxx_k", "mass_kg"), ("gain", "mass"), ("ab", "ac"), ("sensor", "friction_n")] {
            assert_eq!(nearest(word, [known]), None, "{word}");
        }
    }

    #[test]
    fn files_are_told_apart_by_their_names_alone() {
        let known = ["paper-admittance.yaml", "scenes/room-walk.yaml", "my.yaml"];
        assert_eq!(nearest_file("paper-admitance.yaml", known), Some("paper-admittance.yaml"));
        assert_eq!(nearest_file("config/paper-admittance.yml", known), Some("paper-admittance.yaml"));
        assert_eq!(nearest_file("room-wlak.yaml", known), Some("scenes/room-walk.yaml"));
        for other in ["rig.yaml", "a/my/x.yaml", "", "scenes", "absent.yaml"] {
            assert_eq!(nearest_file(other, known), None, "{other}");
        }
    }

    #[test]
    fn a_swap_is_one_edit() {
        assert_eq!(edits("ab", "ba"), 1);
        assert_eq!(edits("", "abc"), 3);
        assert_eq!(edits("kitten", "sitting"), 3);
    }
}
