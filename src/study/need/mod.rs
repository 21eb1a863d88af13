//! The model that a scene needs: speed against accuracy of the whole simulated machine.

mod model;
mod models;
pub(super) mod outputs;
pub(super) mod page;
mod reading;
mod subject;
mod term;
mod terms;
#[cfg(test)]
mod tests;

pub use subject::{Lines, Subject};

use std::sync::Arc;

use self::models::Models;
use self::terms::Terms;
use super::sweep::{Report, Study, Sweep, Table};

/// The study `need`.
pub(super) struct Need {
    own: Option<Arc<Subject>>,
    sweeps: Vec<Box<dyn Sweep>>,
}

impl Need {
    /// The study of the shipped scenes, or of a machine and scene of the user's own.
    pub(super) fn new(own: Option<Arc<Subject>>) -> Self {
        let mut sweeps: Vec<Box<dyn Sweep>> = vec![Box::new(Models::new(own.clone()))];
        if own.is_none() {
            sweeps.push(Box::new(Terms));
        }
        Self { own, sweeps }
    }
}

impl Study for Need {
    fn name(&self) -> &'static str {
        super::NEED
    }

    fn about(&self) -> &'static str {
        "times real time against change of the outputs for each model of a scene, and the simplest fast model that a scene needs"
    }

    fn sweeps(&self) -> &[Box<dyn Sweep>] {
        &self.sweeps
    }

    fn report(&self, tables: &[Table]) -> Report {
        match (tables, &self.own) {
            ([models], Some(subject)) => reading::own(models, subject),
            ([models, terms], None) => reading::shipped(models, terms),
            _ => Report::default(),
        }
    }
}
