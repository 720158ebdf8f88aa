//! A model fitted to recordings, as `leafbench identify` does it.

use clap::ValueEnum;

use super::{CallFailure, FailureKind};
use crate::cancel::CancelFlag;
use crate::cli::identify::{Identified, IdentifyArgs, RecordingStart, SearchMethod};
use crate::identify::FitControl;
use crate::nearest;
use crate::recording::Recording;

/// What is fitted and how.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct IdentifyOrder {
    /// Name of the model; may be empty where there is a specimen.
    pub model: Option<String>,
    /// Path of a specimen file to start from: model, values, geometry.
    pub specimen: Option<std::path::PathBuf>,
    /// `least-squares`, `nelder-mead` or `differential-evolution`.
    pub method: String,
    /// Parameters that are held at a value, in their unit.
    pub fix: Vec<(String, f64)>,
    /// The only parameters that are fitted; empty for all.
    pub free: Vec<String>,
    /// State of the spring at the first sample: `rest`, `cycling` or `unknown`.
    pub begin: String,
    /// Seed of the random draws.
    pub seed: u64,
}

/// Fits a model to recordings: the JSON of `leafbench identify --json`, and the text of a specimen file with the values found.
/// `progress` gets the share of the allowed work, 0 to 1.
pub fn identify(
    recordings: Vec<Recording>,
    order: &IdentifyOrder,
    flag: &CancelFlag,
    progress: &mut dyn FnMut(f64),
) -> Result<(impl serde::Serialize + use<>, String), CallFailure> {
    let args = IdentifyArgs {
        recordings: Vec::new(),
        targets: None,
        model: order.model.clone(),
        specimen: order.specimen.clone(),
        method: chosen::<SearchMethod>("method", &order.method)?,
        fix: order.fix.clone(),
        free: order.free.clone(),
        begin: chosen::<RecordingStart>("begin", &order.begin)?,
        seed: order.seed,
        out: None,
    };
    let found: (Identified, String) = args.identified(|| Ok(recordings), &mut |step| {
        progress(step.share);
        match flag.is_cancelled() {
            true => FitControl::Stop,
            false => FitControl::Continue,
        }
    })?;
    match flag.is_cancelled() {
        true => Err(CallFailure {
            kind: FailureKind::Cancelled,
            ..CallFailure::input("the fit was cancelled: start it again".to_owned())
        }),
        false => Ok(found),
    }
}

/// The value of an option by its name.
fn chosen<T: ValueEnum>(option: &str, word: &str) -> Result<T, CallFailure> {
    T::from_str(word, false).map_err(|_| {
        let values = T::value_variants()
            .iter()
            .filter_map(ValueEnum::to_possible_value);
        let names: Vec<String> = values.map(|value| value.get_name().to_owned()).collect();
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        CallFailure::input(format!(
            "{option} \"{word}\" is unknown{}: use one of {}",
            nearest::question(nearest::name(word, &names)),
            names.join(", ")
        ))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wrong_word_is_asked_about() {
        let asked = chosen::<SearchMethod>("method", "least-sqares").map(drop);
        let text = asked.expect_err("a typo").text;
        assert!(text.contains("did you mean least-squares?"), "{text}");
        assert!(chosen::<RecordingStart>("begin", "rest").is_ok());
    }

    #[test]
    fn a_rate_comes_back() {
        let displacement_mm: Vec<f64> = (0..400)
            .map(|i| 5.0 - 5.0 * (f64::from(i) * 0.05).cos())
            .collect();
        let recording = Recording {
            name: "a".to_owned(),
            time_s: (0..400).map(|i| f64::from(i) * 0.01).collect(),
            force_n: displacement_mm.iter().map(|x| 80.0 * x).collect(),
            displacement_mm,
            ..Recording::default()
        };
        let order = IdentifyOrder {
            model: Some("equivalent".to_owned()),
            method: "least-squares".to_owned(),
            fix: vec![("preload_n".to_owned(), 0.0), ("friction_ratio".to_owned(), 0.0)],
            begin: "rest".to_owned(),
            seed: 1,
            ..IdentifyOrder::default()
        };
        let flag = CancelFlag::default();
        let (found, specimen) =
            identify(vec![recording.clone()], &order, &flag, &mut |_| {}).expect("fitted");
        let found = serde_json::to_value(found).expect("JSON");
        let rate = found["parameters"][1]["value"].as_f64().expect("a number");
        assert!((rate - 80.0).abs() < 1e-3, "{found}");
        assert!(specimen.contains("rate_n_per_mm"), "{specimen}");
        flag.cancel();
        let failure = identify(vec![recording], &order, &flag, &mut |_| {}).map(drop);
        assert_eq!(failure.expect_err("cancelled").kind, FailureKind::Cancelled);
    }
}
