//! Size of a test over combinations: a drawn share of the cases, or every case.
// No package uses all of it in each of its builds.
#![allow(dead_code)]

/// Variable of the environment: `all` asks for every case, as `hil-tests/run --all` does; a number is the seed that draws the share.
const SIZE: &str = "YIELDWALL_TESTS";

/// Whether every case is asked for.
fn is_whole() -> bool {
    std::env::var(SIZE).is_ok_and(|size| size == "all")
}

/// Draws `count` of the cases and keeps their order, or returns every case. A test that fails prints how to draw its share again.
pub(crate) fn share<T>(cases: impl IntoIterator<Item = T>, count: usize) -> Vec<T> {
    let mut cases: Vec<T> = cases.into_iter().collect();
    if is_whole() || count >= cases.len() {
        return cases;
    }
    let seed = std::env::var(SIZE).ok().and_then(|size| size.parse().ok()).unwrap_or(1);
    println!("{count} of {} cases; this share again: {SIZE}={seed}, all of them: {SIZE}=all", cases.len());
    let (mut state, mut wanted, mut left) = (seed, count as u64, cases.len() as u64);
    cases.retain(|_| {
        // Splitmix64.
        state = u64::wrapping_add(state, 0x9e37_79b9_7f4a_7c15);
        let mut noise = state;
        noise = (noise ^ (noise >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        noise = (noise ^ (noise >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        let is_drawn = (noise ^ (noise >> 31)) % left < wanted;
        wanted -= u64::from(is_drawn);
        left -= 1;
        is_drawn
    });
    cases
}

/// Number of random cases of a property: `whole`, or a quarter of it.
pub(crate) fn cases(whole: u32) -> u32 {
    if is_whole() { whole } else { whole.div_ceil(4) }
}

/// Lets every user write to a file or folder.
#[cfg(unix)]
pub(crate) fn let_others_write(path: &std::path::Path) {
    use std::os::unix::fs::PermissionsExt;

    let mode = std::fs::metadata(path).unwrap().permissions().mode();
    std::fs::set_permissions(path, std::fs::Permissions::from_mode(mode | 0o022)).unwrap();
}
