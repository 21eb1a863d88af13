//! Numbers as electronic data sheets write them.

use std::ops::Range;

use super::Value;
use super::ini::unquoted;

/// Data types of CiA 301 by their numbers: bits and whether they have a sign. `None` for what is no integer.
pub(super) fn integer(data_type: u16) -> Option<(u32, bool)> {
    Some(match data_type {
        0x01 => (1, false),
        0x02 => (8, true),
        0x03 => (16, true),
        0x04 => (32, true),
        0x05 => (8, false),
        0x06 => (16, false),
        0x07 => (32, false),
        0x10 => (24, true),
        0x12 => (40, true),
        0x13 => (48, true),
        0x14 => (56, true),
        0x15 => (64, true),
        0x16 => (24, false),
        0x18 => (40, false),
        0x19 => (48, false),
        0x1a => (56, false),
        0x1b => (64, false),
        _ => return None,
    })
}

/// A whole number: decimal, hexadecimal behind `0x`, or octal behind a further `0`.
pub(super) fn whole(text: &str) -> Option<i128> {
    let text = text.trim();
    let (sign, digits) = match text.strip_prefix('-') {
        Some(rest) => (-1, rest.trim_start()),
        None => (1, text.strip_prefix('+').unwrap_or(text).trim_start()),
    };
    // The parser would take a second sign.
    if !digits.starts_with(|one: char| one.is_ascii_digit()) {
        return None;
    }
    let hexadecimal = digits.strip_prefix("0x").or_else(|| digits.strip_prefix("0X"));
    let number = match hexadecimal {
        Some(digits) => i128::from(u64::from_str_radix(digits, 16).ok()?),
        None if digits.len() > 1 && digits.starts_with('0') && digits.bytes().all(|one| matches!(one, b'0'..=b'7')) => {
            i128::from(u64::from_str_radix(digits, 8).ok()?)
        }
        None => i128::from(digits.parse::<u64>().ok()?),
    };
    Some(sign * number)
}

/// A whole number with what many tools write behind it: a comment without a blank before it.
pub(super) fn number(text: &str) -> Option<i128> {
    whole(text.split(';').next().unwrap_or_default())
}

/// A value that is not written as the standard has it and can mean one thing alone, and what is odd of it.
pub(super) fn odd_value(text: &str, data_type: u16) -> Option<(Value, &'static str)> {
    let (bits, is_signed) = integer(data_type)?;
    let before = text.split(';').next().unwrap_or_default();
    if before.len() < text.len()
        && let Ok(value) = value(before, data_type)
    {
        return Some((value, "has a comment right behind it"));
    }
    let lower: String = text.chars().filter(|one| !one.is_whitespace()).flat_map(char::to_lowercase).collect();
    if data_type == 0x01 && (lower == "true" || lower == "false") {
        return Some((Value::Integer(i128::from(lower == "true")), "is a word and no number"));
    }
    if let Some(rest) = lower.strip_prefix("nodeid+").or_else(|| lower.strip_suffix("+nodeid")) {
        let number = fit(whole(rest)?, bits, is_signed)?;
        return Some((Value::OfNode(number), "has no `$` before NODEID"));
    }
    let (rest, is_of_node) = match lower.strip_prefix("$nodeid+").or_else(|| lower.strip_suffix("+$nodeid")) {
        Some(rest) => (rest, true),
        None => (lower.as_str(), false),
    };
    let (digits, has_mark) = match rest.strip_suffix('h') {
        Some(digits) => (digits, true),
        None => (rest, false),
    };
    let is_hexadecimal = (1..=16).contains(&digits.len()) && digits.bytes().all(|one| one.is_ascii_hexdigit());
    // Without a letter it would be decimal.
    if !is_hexadecimal || !(has_mark || digits.bytes().any(|one| one.is_ascii_alphabetic())) {
        return None;
    }
    let number = fit(i128::from(u64::from_str_radix(digits, 16).ok()?), bits, is_signed)?;
    let value = if is_of_node { Value::OfNode(number) } else { Value::Integer(number) };
    Some((value, "has no `0x` before it"))
}

/// A value of this type; `Err` says what is wrong with it.
pub(super) fn value(text: &str, data_type: u16) -> Result<Value, String> {
    if let Some((bits, is_signed)) = integer(data_type) {
        let (number, is_of_node) = of_node(text).ok_or_else(|| format!("`{text}` is not a whole number"))?;
        let number = fit(number, bits, is_signed).ok_or_else(|| {
            format!("`{text}` has no place in {bits} bits{}", if is_signed { " with a sign" } else { "" })
        })?;
        return Ok(if is_of_node { Value::OfNode(number) } else { Value::Integer(number) });
    }
    match data_type {
        0x08 | 0x11 => real(text).map(Value::Real).ok_or_else(|| format!("`{text}` is no finite number")),
        0x0a => bytes(text).map(Value::Bytes).ok_or_else(|| format!("`{text}` is no row of bytes in hexadecimal")),
        _ => Ok(Value::Text(unquoted(text).to_owned())),
    }
}

/// A number with or without the node id in front of it or behind it.
fn of_node(text: &str) -> Option<(i128, bool)> {
    let plain: String = text.chars().filter(|one| !one.is_whitespace()).collect();
    let lower = plain.to_ascii_lowercase();
    let Some(at) = lower.find("$nodeid") else { return Some((whole(&plain)?, false)) };
    let (before, behind) = (&plain[..at], &plain[at + "$nodeid".len()..]);
    let rest = match (before, behind) {
        ("", "") => return Some((0, true)),
        ("", behind) => behind.strip_prefix('+')?,
        (before, "") => before.strip_suffix('+')?,
        _ => return None,
    };
    Some((whole(rest)?, true))
}

/// The numbers that a type has.
pub(super) fn range(bits: u32, is_signed: bool) -> Range<i128> {
    let all = 1_i128 << bits;
    if is_signed { -(all / 2)..all / 2 } else { 0..all }
}

/// Returns the number in this many bits. For a signed type it also accepts the bit pattern, which many tools write.
pub(super) fn fit(number: i128, bits: u32, is_signed: bool) -> Option<i128> {
    let all = 1_i128 << bits;
    match number {
        number if range(bits, is_signed).contains(&number) => Some(number),
        number if is_signed && (all / 2..all).contains(&number) => Some(number - all),
        _ => None,
    }
}

/// A real number, as decimal or as its bit pattern in hexadecimal.
fn real(text: &str) -> Option<f64> {
    let value = match text.strip_prefix("0x").or_else(|| text.strip_prefix("0X")) {
        Some(digits) if digits.len() <= 8 => f64::from(f32::from_bits(u32::from_str_radix(digits, 16).ok()?)),
        Some(digits) => f64::from_bits(u64::from_str_radix(digits, 16).ok()?),
        None => text.trim().parse().ok()?,
    };
    value.is_finite().then_some(value)
}

fn bytes(text: &str) -> Option<Vec<u8>> {
    let digits: String = text.chars().filter(|one| !one.is_whitespace()).collect();
    let digits = digits.strip_prefix("0x").unwrap_or(&digits);
    if !digits.len().is_multiple_of(2) || !digits.bytes().all(|one| one.is_ascii_hexdigit()) {
        return None;
    }
    (0..digits.len()).step_by(2).map(|at| u8::from_str_radix(&digits[at..at + 2], 16).ok()).collect()
}
