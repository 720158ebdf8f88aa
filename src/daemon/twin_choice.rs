//! Which model the twin of the next run has: that of the bench file, or the improved one of a diagnosis. The check of a profile
//! before a run uses the same model. A new daemon begins with the model of the bench file.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::config::{Bench, ModelConfig};

/// The model that was chosen. Clones share it.
#[derive(Clone, Default)]
pub(super) struct TwinChoice(Arc<Mutex<Option<ImprovedTwin>>>);

/// The improved model of a diagnosis.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct ImprovedTwin {
    /// Id of the diagnosis.
    pub diagnosis: String,
    pub model: ModelConfig,
}

impl ImprovedTwin {
    /// Model and effects, for people: `equivalent + backlash`.
    fn words(&self) -> String {
        let effects = self.model.effects.iter().map(|effect| effect.code.as_str());
        let law = self.model.law.as_ref().map(|_| "law read off recordings");
        let parts: Vec<&str> = std::iter::once(self.model.name.as_str())
            .chain(effects)
            .chain(law)
            .collect();
        parts.join(" + ")
    }
}

impl TwinChoice {
    fn lock(&self) -> MutexGuard<'_, Option<ImprovedTwin>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes an improved model, or with `None` that of the bench file again.
    pub(super) fn set(&self, twin: Option<ImprovedTwin>) {
        *self.lock() = twin;
    }

    /// The bench with the model that was chosen in its twin. Its specimen stays.
    pub(super) fn applied_to(&self, bench: &Arc<Bench>) -> Arc<Bench> {
        match &*self.lock() {
            None => Arc::clone(bench),
            Some(improved) => Arc::new(Bench {
                model: improved.model.clone(),
                ..Bench::clone(bench)
            }),
        }
    }

    /// The model for people and headers of recordings: that of `bench`, or the improved one with its diagnosis.
    pub(super) fn words(&self, bench: &Bench) -> String {
        match &*self.lock() {
            None => bench.model.name.clone(),
            Some(improved) => format!("{} (diagnosis {})", improved.words(), improved.diagnosis),
        }
    }

    /// Id of the diagnosis; empty for the model of the bench file.
    pub(super) fn diagnosis(&self) -> String {
        let chosen = self.lock();
        chosen
            .as_ref()
            .map(|improved| improved.diagnosis.clone())
            .unwrap_or_default()
    }
}
