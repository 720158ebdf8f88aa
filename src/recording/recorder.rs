//! Recorders that pass a run on: to several recorders, and to a thread behind a bounded ring. What is done with the samples
//! is left to the recorders behind them.
//!
//! Control uses only `&mut dyn Recorder`. In real time that is a [`RecorderInput`], which never waits. In virtual time it is
//! the chain itself, called directly: a slow disk then slows the run down and no samples are lost.

use std::io;
use std::thread::{self, JoinHandle};
use std::time::Duration;

use rtrb::{Consumer, Producer};

use super::{Event, EventKind, Flags, Header, Outcome, Recorder, Sample, StreamEvent};
use crate::ring;

/// Samples that fit between control and the recording thread: 65 s at 1 kHz.
const RING_SAMPLES: usize = 65_536;
/// Places that samples leave free, so that events and the end of a run still fit into the ring.
const RESERVED_FOR_EVENTS: usize = 256;
/// Sleep of the thread between two looks at the ring. Sleep and commit together stay well under 20 ms.
const DRAIN_PERIOD: Duration = Duration::from_millis(8);

/// Passes everything on to each of its recorders, in order.
#[derive(Default)]
pub(crate) struct FanOut(pub Vec<Box<dyn Recorder + Send>>);

impl Recorder for FanOut {
    fn begin(&mut self, header: &Header) {
        self.0.iter_mut().for_each(|recorder| recorder.begin(header));
    }

    fn sample(&mut self, sample: &Sample) {
        self.0.iter_mut().for_each(|recorder| recorder.sample(sample));
    }

    fn event(&mut self, event: &Event) {
        self.0.iter_mut().for_each(|recorder| recorder.event(event));
    }

    fn end(&mut self, outcome: &Outcome) {
        self.0.iter_mut().for_each(|recorder| recorder.end(outcome));
    }

    fn flush(&mut self) {
        self.0.iter_mut().for_each(|recorder| recorder.flush());
    }
}

/// Content of the ring. A single ring keeps samples and events in their order.
enum Item {
    Begin(Box<Header>),
    Sample(Sample),
    Event(Event),
    StreamEvent(StreamEvent),
    End(Box<Outcome>),
}

impl Item {
    /// An item that needs no memory of its own.
    fn filler() -> Item {
        Item::Event(Event {
            tick: 0,
            time_s: 0.0,
            kind: EventKind::Host,
            text: String::new(),
        })
    }
}

/// The end of the ring that control writes to. It never waits. It counts what does not fit, reports it as an event and flags
/// the next sample.
pub(crate) struct RecorderInput {
    ring: Producer<Item>,
    thread: thread::Thread,
    overrun: Overrun,
}

/// Items that did not fit since the last item that did.
#[derive(Default)]
struct Overrun {
    samples: u64,
    events: u64,
    first_tick: u64,
    last_tick: u64,
    last_time_s: f64,
}

impl RecorderInput {
    /// Writes an item into the ring if more than `reserve` places are free.
    fn push(&mut self, item: Item, reserve: usize) -> bool {
        self.ring.slots() > reserve && self.ring.push(item).is_ok()
    }

    fn push_event(&mut self, item: Item, tick: u64, time_s: f64) {
        // Two places stay free: one to report an overrun, one for the end.
        if !self.push(item, 2) {
            self.note_overrun(tick, time_s);
            self.overrun.events += 1;
        }
    }

    fn note_overrun(&mut self, tick: u64, time_s: f64) {
        if self.overrun.samples + self.overrun.events == 0 {
            self.overrun.first_tick = tick;
        }
        self.overrun.last_tick = tick;
        self.overrun.last_time_s = time_s;
    }

    /// Reports an overrun as an event as soon as there is room; true if it did so now.
    fn report_overrun(&mut self, reserve: usize) -> bool {
        let missed = &self.overrun;
        if missed.samples + missed.events == 0 || self.ring.slots() <= reserve + 1 {
            return false;
        }
        let text = format!(
            "recording fell behind: {} samples and {} events between ticks {} and {} were not recorded: reduce the load on \
             the disk",
            missed.samples, missed.events, missed.first_tick, missed.last_tick
        );
        let event = Event {
            tick: missed.last_tick,
            time_s: missed.last_time_s,
            kind: EventKind::Host,
            text,
        };
        let reported = self.push(Item::Event(event), reserve);
        if reported {
            self.overrun = Overrun::default();
        }
        reported
    }
}

impl Recorder for RecorderInput {
    fn begin(&mut self, header: &Header) {
        self.push(Item::Begin(Box::new(header.clone())), 1);
    }

    fn sample(&mut self, sample: &Sample) {
        let mut sample = *sample;
        if self.report_overrun(RESERVED_FOR_EVENTS) {
            sample.flags.insert(Flags::AFTER_GAP);
        }
        let behind = self.overrun.samples > 0;
        if behind || !self.push(Item::Sample(sample), RESERVED_FOR_EVENTS) {
            self.note_overrun(sample.tick, sample.time_s);
            self.overrun.samples += 1;
        }
    }

    fn event(&mut self, event: &Event) {
        self.push_event(Item::Event(event.clone()), event.tick, event.time_s);
    }

    fn stream_event(&mut self, event: &StreamEvent) {
        self.push_event(Item::StreamEvent(*event), event.tick, event.time_s);
    }

    fn end(&mut self, outcome: &Outcome) {
        self.report_overrun(0);
        // The last place is kept for this item. Without it the thread would still end when this input is dropped.
        self.push(Item::End(Box::new(outcome.clone())), 0);
        self.thread.unpark();
    }
}

/// Handle of the recording thread; call `join` after the end of the run.
pub(crate) struct RecorderThread<R> {
    thread: JoinHandle<R>,
}

impl<R> RecorderThread<R> {
    /// Waits until everything is recorded and returns the chain; `None` if the thread panicked.
    pub(crate) fn join(self) -> Option<R> {
        self.thread.join().ok()
    }
}

/// Starts a thread that takes one run from control and passes it to `chain`, with a flush about every 10 ms.
/// The thread ends after the end of the run, or when the input is dropped.
pub(crate) fn spawn<R: Recorder + Send + 'static>(
    chain: R,
) -> io::Result<(RecorderInput, RecorderThread<R>)> {
    spawn_with_ring(chain, RING_SAMPLES)
}

fn spawn_with_ring<R: Recorder + Send + 'static>(
    chain: R,
    samples: usize,
) -> io::Result<(RecorderInput, RecorderThread<R>)> {
    let (ring, consumer) = ring::touched(samples + RESERVED_FOR_EVENTS, Item::filler);
    let thread = thread::Builder::new().name("recorder".into()).spawn(move || {
        raise_priority();
        record(chain, consumer)
    })?;
    let input = RecorderInput {
        ring,
        thread: thread.thread().clone(),
        overrun: Overrun::default(),
    };
    Ok((input, RecorderThread { thread }))
}

/// Priority below control and above all others, so that a busy host does not delay the recording. If the host does not allow
/// it, the ring still holds a minute. Control reports missing real-time rights, once, for both threads.
fn raise_priority() {
    use thread_priority::{
        RealtimeThreadSchedulePolicy, ThreadPriority, ThreadPriorityValue, ThreadSchedulePolicy,
    };
    let Ok(low) = ThreadPriorityValue::try_from(10u8) else {
        return;
    };
    let _ = thread_priority::set_thread_priority_and_policy(
        thread_priority::thread_native_id(),
        ThreadPriority::Crossplatform(low),
        ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo),
    );
}

fn record<R: Recorder>(mut chain: R, mut ring: Consumer<Item>) -> R {
    loop {
        // Read before the ring is emptied: what the input wrote before it was dropped is recorded below.
        let abandoned = ring.is_abandoned();
        while let Ok(item) = ring.pop() {
            match item {
                Item::Begin(header) => chain.begin(&header),
                Item::Sample(sample) => chain.sample(&sample),
                Item::Event(event) => chain.event(&event),
                Item::StreamEvent(event) => chain.stream_event(&event),
                Item::End(outcome) => {
                    chain.end(&outcome);
                    return chain;
                }
            }
        }
        chain.flush();
        if abandoned {
            return chain;
        }
        thread::park_timeout(DRAIN_PERIOD);
    }
}

#[cfg(test)]
mod tests {
    use std::sync::{Arc, Mutex, mpsc};

    use super::super::memory::Memory;
    use super::super::run_file::test_support::{header, outcome, sample};
    use super::*;

    fn event(tick: u64) -> Event {
        Event {
            tick,
            time_s: 0.0,
            kind: EventKind::Operator,
            text: "hold".into(),
        }
    }

    fn drive(recorder: &mut dyn Recorder) {
        recorder.begin(&header());
        for tick in 0..3000 {
            recorder.sample(&sample(tick));
            if tick % 1000 == 0 {
                recorder.event(&event(tick));
            }
        }
        recorder.end(&outcome(3000));
    }

    #[test]
    fn the_thread_records_the_same_as_a_direct_call() {
        let mut direct = Memory::default();
        drive(&mut direct);
        let (mut input, thread) = spawn(Memory::default()).unwrap();
        drive(&mut input);
        assert_eq!(thread.join().unwrap(), direct);
    }

    #[test]
    fn a_dropped_input_ends_the_thread_with_all_samples() {
        let (mut input, thread) = spawn(Memory::default()).unwrap();
        input.sample(&sample(0));
        drop(input);
        let memory = thread.join().unwrap();
        assert_eq!((memory.samples.len(), memory.outcome), (1, None));
    }

    /// A recorder that waits in `begin` until the test lets it go on.
    struct Stalled {
        memory: Memory,
        go_on: mpsc::Receiver<()>,
        reached: mpsc::Sender<()>,
    }

    impl Recorder for Stalled {
        fn begin(&mut self, header: &Header) {
            self.memory.begin(header);
            self.reached.send(()).unwrap();
            self.go_on.recv().unwrap();
        }
        fn sample(&mut self, sample: &Sample) {
            self.memory.sample(sample);
        }
        fn event(&mut self, event: &Event) {
            self.memory.event(event);
        }
        fn end(&mut self, outcome: &Outcome) {
            self.memory.end(outcome);
        }
    }

    #[test]
    fn k3_an_overrun_is_counted_told_and_flagged_and_the_end_gets_through() {
        let (go, go_on) = mpsc::channel();
        let (reached, at_begin) = mpsc::channel();
        let chain = Stalled {
            memory: Memory::default(),
            go_on,
            reached,
        };
        let (mut input, thread) = spawn_with_ring(chain, 100).unwrap();
        input.begin(&header());
        at_begin.recv().unwrap();
        for tick in 0..150 {
            input.sample(&sample(tick));
        }
        input.event(&event(150));
        input.end(&outcome(150));
        go.send(()).unwrap();
        let memory = thread.join().unwrap().memory;
        assert_eq!(memory.samples.len(), 100, "the ring holds 100 samples");
        assert_eq!(memory.events[0], event(150));
        assert!(
            memory.events[1]
                .text
                .contains("50 samples and 0 events between ticks 100 and 149")
        );
        assert_eq!(memory.outcome, Some(outcome(150)));
    }

    #[test]
    fn a_fan_out_passes_the_run_to_each_recorder() {
        let kept: [Arc<Mutex<Memory>>; 2] = std::array::from_fn(|_| Arc::default());
        let mut chain = FanOut(kept.iter().map(|k| Box::new(Arc::clone(k)) as _).collect());
        drive(&mut chain);
        let mut direct = Memory::default();
        drive(&mut direct);
        for memory in &kept {
            assert_eq!(*memory.lock().unwrap(), direct);
        }
    }
}
