//! The course of a predicted run, thinned for a drawing: of each stretch the ticks with the lowest and the highest command.

use serde::{Deserialize, Serialize};

use crate::twin::Predicted;
use crate::units::Command;

/// Stretches into which a run is divided. Each gives two points, so that a sine of any length keeps its peaks; a drawing of
/// 600 pixels shows no more.
pub(super) const STRETCHES: u64 = 600;

/// Commanded and predicted values over time, one value of each for every point.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub(crate) struct PlannedCourse {
    /// Time from the start in s.
    pub time_s: Vec<f64>,
    /// Command in mm or N, as the profile controls.
    pub command: Vec<f64>,
    /// Predicted displacement in mm.
    pub displacement_mm: Vec<f64>,
    /// Predicted force in N.
    pub force_n: Vec<f64>,
}

/// Takes every tick of a prediction and keeps what a drawing shows.
pub(super) struct CourseThinner {
    course: PlannedCourse,
    rate_hz: f64,
    /// Ticks of a stretch.
    stretch: u64,
    tick: u64,
    /// Tick and values of the lowest and of the highest command of the stretch.
    ends: Option<[(u64, Predicted); 2]>,
}

fn command(predicted: &Predicted) -> f64 {
    match predicted.slot.command {
        Command::Displacement(value) | Command::Force(value) => value,
    }
}

impl CourseThinner {
    /// For a run of so many ticks.
    pub(super) fn new(total_ticks: u64, rate_hz: f64) -> Self {
        CourseThinner {
            course: PlannedCourse::default(),
            rate_hz,
            stretch: total_ticks.div_ceil(STRETCHES).max(1),
            tick: 0,
            ends: None,
        }
    }

    pub(super) fn take(&mut self, predicted: &Predicted) {
        self.tick += 1;
        let new = (self.tick, *predicted);
        let [low, high] = self.ends.get_or_insert([new, new]);
        if command(predicted) < command(&low.1) {
            *low = new;
        }
        if command(predicted) > command(&high.1) {
            *high = new;
        }
        if self.tick.is_multiple_of(self.stretch) {
            self.close();
        }
    }

    fn close(&mut self) {
        let Some(mut ends) = self.ends.take() else {
            return;
        };
        ends.sort_by_key(|(tick, _)| *tick);
        let [first, last] = ends;
        self.push(first);
        if last.0 != first.0 {
            self.push(last);
        }
    }

    fn push(&mut self, (tick, predicted): (u64, Predicted)) {
        self.course.time_s.push(tick as f64 / self.rate_hz);
        self.course.command.push(command(&predicted));
        self.course.displacement_mm.push(predicted.displacement_mm);
        self.course.force_n.push(predicted.force_n);
    }

    /// The course of all ticks that were taken.
    pub(super) fn end(mut self) -> PlannedCourse {
        self.close();
        self.course
    }
}
