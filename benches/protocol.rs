//! How fast frames are decoded and encoded. A full bus at 1 Mbit/s brings some 7 500 frames a second.

use std::hint::black_box;

use crate::protocol::frame::Frame;
use crate::protocol::message::{CommandMessage, FromRig, SampleMessage, ToRig, WireMode};
use crate::protocol::serial_framing::{Decoder, PACKET_MAX, encode};
use criterion::{Criterion, Throughput};

const NODE: u8 = 1;
const FRAMES: u16 = 1000;

fn samples() -> Vec<Frame> {
    (0..FRAMES)
        .map(|tick| {
            let sample = FromRig::Sample(SampleMessage {
                counter: (tick % 15) as u8,
                tick,
                force_counts: i32::from(tick) * 20,
                displacement_counts: -i32::from(tick) * 30,
            });
            sample.encode(NODE)
        })
        .collect()
}

pub fn protocol(criterion: &mut Criterion) {
    let frames = samples();
    let mut group = criterion.benchmark_group("frames");
    group.throughput(Throughput::Elements(u64::from(FRAMES)));
    group.bench_function("decode samples", |bencher| {
        bencher.iter(|| {
            frames
                .iter()
                .filter(|&frame| FromRig::decode(black_box(frame), NODE).is_ok())
                .count()
        })
    });
    group.bench_function("encode commands", |bencher| {
        bencher.iter(|| {
            for tick in 0..FRAMES {
                let command = ToRig::Command(CommandMessage {
                    counter: (tick % 15) as u8,
                    session: 1,
                    tick,
                    mode: WireMode::Force,
                    counts: i32::from(tick),
                    last: false,
                });
                black_box(black_box(command).encode(NODE));
            }
        })
    });
    let mut line = vec![];
    for frame in &frames {
        let mut packet = [0; PACKET_MAX];
        let len = encode(frame, &mut packet);
        line.extend_from_slice(&packet[..len]);
    }
    let mut decoder = Decoder::default();
    group.bench_function("decode samples from serial", |bencher| {
        bencher.iter(|| {
            let arrived = line.iter().filter_map(|&byte| decoder.push(black_box(byte)));
            arrived
                .filter(|frame| FromRig::decode(frame, NODE).is_ok())
                .count()
        })
    });
    group.finish();
}
