//! Takes offsets out of data that are being fitted, and out of recordings.

use super::offsets::FileOffsets;
use crate::diagnose::fitting::data::Data;
use crate::recording::Recording;

/// The data without the offsets.
pub(super) fn shifted(data: &Data, offsets: &[FileOffsets]) -> Data {
    let mut data = data.clone();
    let mut from = 0;
    for (track, offset) in data.tracks.iter_mut().zip(offsets) {
        let n = track.len();
        let at =
            |values: &[f64], i: usize| interpolated(&track.time_s, values, track.time_s[i] - offset.delay_s);
        if offset.delay_s != 0.0 {
            let x: Vec<f64> = (0..n).map(|i| at(&track.displacement_mm, i)).collect();
            let column =
                |f: fn(&crate::model::Motion) -> f64| track.motion.iter().map(f).collect::<Vec<f64>>();
            let (speeds, accelerations) = (column(|m| m.velocity_mm_s), column(|m| m.acceleration_mm_s2));
            let moved: Vec<[f64; 2]> = (0..n).map(|i| [at(&speeds, i), at(&accelerations, i)]).collect();
            for (motion, [speed, acceleration]) in track.motion.iter_mut().zip(moved) {
                (motion.velocity_mm_s, motion.acceleration_mm_s2) = (speed, acceleration);
            }
            track.displacement_mm = x;
        }
        for i in 0..n {
            track.displacement_mm[i] -= offset.displacement_mm;
            track.force_n[i] -= offset.force_n;
            data.force_n[from + i] -= offset.force_n;
            for reach_mm in &mut track.motion[i].reach_mm {
                *reach_mm -= offset.displacement_mm;
            }
        }
        from += n;
    }
    data
}

/// Linear interpolation in a column over rising times; the ends are constant.
fn interpolated(time_s: &[f64], values: &[f64], at_s: f64) -> f64 {
    let after = time_s.partition_point(|t| *t < at_s);
    if after == 0 || after == time_s.len() {
        return values[after.min(time_s.len() - 1)];
    }
    let share = (at_s - time_s[after - 1]) / (time_s[after] - time_s[after - 1]);
    values[after - 1] + share * (values[after] - values[after - 1])
}

/// The recordings without a zero of the displacement that they share.
pub(in crate::diagnose::fitting) fn without_zero(recordings: &[Recording], zero_mm: f64) -> Vec<Recording> {
    let offset = FileOffsets {
        displacement_mm: zero_mm,
        ..FileOffsets::default()
    };
    corrected(recordings, &vec![offset; recordings.len()])
}

/// The recordings without their offsets. A sample whose force lies beyond the recording by the delay is left out.
pub(in crate::diagnose::fitting) fn corrected(
    recordings: &[Recording],
    offsets: &[FileOffsets],
) -> Vec<Recording> {
    let without = |(recording, offset): (&Recording, &FileOffsets)| {
        let time_s = &recording.time_s;
        let ends_s = [time_s[0], time_s[time_s.len() - 1]];
        let there = |i: &usize| (ends_s[0]..=ends_s[1]).contains(&(time_s[*i] + offset.delay_s));
        let kept: Vec<usize> = (0..time_s.len()).filter(there).collect();
        let force_n = |i: usize| interpolated(time_s, &recording.force_n, time_s[i] + offset.delay_s);
        let pick = |values: &[f64]| kept.iter().map(|&i| values[i]).collect::<Vec<f64>>();
        Recording {
            name: recording.name.clone(),
            time_s: pick(time_s),
            displacement_mm: kept
                .iter()
                .map(|&i| recording.displacement_mm[i] - offset.displacement_mm)
                .collect(),
            force_n: kept.iter().map(|&i| force_n(i) - offset.force_n).collect(),
            command: recording.command.as_deref().map(pick),
            command_mode: recording.command_mode,
            cycle: (recording.cycle.as_ref())
                .map(|c| kept.iter().filter_map(|&i| c.get(i).copied()).collect()),
            flags: (recording.flags.as_ref())
                .map(|f| kept.iter().filter_map(|&i| f.get(i).copied()).collect()),
        }
    };
    recordings.iter().zip(offsets).map(without).collect()
}
