//! Meanings of a vendor's error codes: the codes in 603Fh, in 1003h and in emergency messages.
//!
//! A table is a file. [`SHIPPED`] holds the texts of the files in `drives/codes`; a device profile names the table of its device.
//! The main crate reads them, with the feature `config` of this crate.

use std::collections::BTreeMap;

#[cfg(feature = "config")]
use garde::Validate;
#[cfg(feature = "config")]
use schemars::JsonSchema;
#[cfg(feature = "config")]
use serde::{Deserialize, Serialize};

macro_rules! shipped {
    ($($name:literal),* $(,)?) => {
        &[$(($name, include_str!(concat!("../codes/", $name, ".yaml")))),*]
    };
}

/// The tables that come with the program: name and text, in alphabetical order.
pub const SHIPPED: &[(&str, &str)] =
    shipped!["elmo-gold", "inovance-sv660n", "maxon-epos4", "synapticon-somanet", "zeroerr-edriver"];

/// The error codes of one family of devices.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "config", derive(Serialize, Deserialize, JsonSchema, Validate))]
#[cfg_attr(feature = "config", serde(deny_unknown_fields), garde(allow_unvalidated))]
pub struct ErrorCodes {
    /// Name of the table, and its sources.
    #[cfg_attr(feature = "config", garde(dive))]
    pub error_codes: About,
    /// The codes.
    #[cfg_attr(feature = "config", garde(length(min = 1, max = 4096), dive))]
    pub codes: Vec<ErrorCode>,
}

/// Name of a table of error codes, and its sources.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "config", derive(Serialize, Deserialize, JsonSchema, Validate))]
#[cfg_attr(feature = "config", serde(deny_unknown_fields), garde(allow_unvalidated))]
#[cfg_attr(feature = "config", schemars(rename = "AboutErrorCodes"))]
pub struct About {
    /// Name for messages.
    #[cfg_attr(feature = "config", garde(length(min = 1)))]
    pub name: String,
    /// Documents behind the table, by the short names that `source` uses.
    #[cfg_attr(feature = "config", garde(length(min = 1)))]
    pub sources: BTreeMap<String, String>,
}

/// One error code.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "config", derive(Serialize, Deserialize, JsonSchema, Validate))]
#[cfg_attr(feature = "config", serde(deny_unknown_fields), garde(allow_unvalidated))]
pub struct ErrorCode {
    /// The code, as in 603Fh and in emergency messages.
    pub code: u16,
    /// Short name.
    #[cfg_attr(feature = "config", garde(length(min = 1, max = 64)))]
    pub name: String,
    /// Meaning of the code.
    #[cfg_attr(feature = "config", garde(length(min = 1, max = 400)))]
    pub meaning: String,
    /// Usual cause.
    #[cfg_attr(feature = "config", garde(length(min = 1, max = 400)))]
    pub cause: String,
    /// Remedy.
    #[cfg_attr(feature = "config", garde(length(min = 1, max = 400)))]
    pub next: String,
    /// Source: a key of `error_codes.sources`.
    #[cfg_attr(feature = "config", garde(length(min = 1)))]
    pub source: String,
}

impl ErrorCodes {
    /// Returns the entry of a code.
    pub fn of(&self, code: u16) -> Option<&ErrorCode> {
        self.codes.iter().find(|known| known.code == code)
    }

    /// The document from which a code was read.
    pub fn document(&self, code: &ErrorCode) -> Option<&str> {
        self.error_codes.sources.get(&code.source).map(String::as_str)
    }
}
