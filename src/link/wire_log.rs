//! A log of the frames of a link, in the format of `candump -L`, for `canplayer` and the other tools of can-utils. The owner of the
//! link only puts frames into a ring; a thread of its own writes the file. A ring that is full drops frames and counts them: the
//! log of the program says how many, and an error frame (overflow) stands in their place.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, mpsc};
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use super::{Link, now_ns};
use crate::protocol::frame::Frame;
use crate::ring;
use crate::units::NS_PER_S;

/// Frames that wait for the thread: more than 7 s of both directions.
const RING_FRAMES: usize = 16_384;
/// Pause between two looks at the rings.
const DRAIN_PERIOD: Duration = Duration::from_millis(20);
/// Longest wait for the thread at the end: a disk that hangs does not keep the program.
const END_WITHIN: Duration = Duration::from_secs(1);

/// A frame with the time at which this end sent or received it, monotonic ns.
type Logged = (u64, Frame);

/// The link's end of the log. Taking a frame neither waits nor allocates.
pub(super) struct Tap {
    ring: rtrb::Producer<Logged>,
    dropped: Arc<AtomicU64>,
}

impl Tap {
    /// Takes a frame, or counts it where the ring is full.
    pub(super) fn take(&mut self, frame: &Frame) {
        if self.ring.push((now_ns(), *frame)).is_err() {
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
    }
}

/// The thread's end of one tap.
struct TapEnd {
    ring: rtrb::Consumer<Logged>,
    dropped: Arc<AtomicU64>,
}

/// A log that links can be tied to. Clones share the file.
#[derive(Debug, Clone)]
pub(crate) struct WireLog(mpsc::Sender<TapEnd>);

impl std::fmt::Debug for TapEnd {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("TapEnd")
    }
}

/// The thread that writes.
pub(crate) struct WireLogThread {
    thread: JoinHandle<()>,
    ends: Arc<AtomicBool>,
}

impl WireLog {
    /// Creates the file and starts the thread. `name` is the name of the interface in the lines. The log never takes more than
    /// `max_bytes`: at half of it the file becomes `FILE.old`, and a new one begins.
    pub(crate) fn start(path: &Path, name: &str, max_bytes: u64) -> io::Result<(WireLog, WireLogThread)> {
        let file = LogFile::create(path, name, max_bytes / 2)?;
        let (new_taps, taps) = mpsc::channel();
        let ends = Arc::new(AtomicBool::new(false));
        let until = Arc::clone(&ends);
        let thread = std::thread::Builder::new()
            .name("wire log".to_owned())
            .spawn(move || write_until(&until, &taps, file))?;
        Ok((WireLog(new_taps), WireLogThread { thread, ends }))
    }

    /// Logs the frames of this link from now on.
    pub(crate) fn follow(&self, link: &mut Link) {
        let (ring, end) = ring::touched(RING_FRAMES, || (0, Frame::new(0, &[])));
        let dropped = Arc::new(AtomicU64::new(0));
        link.tap = Some(Tap {
            ring,
            dropped: Arc::clone(&dropped),
        });
        // Fails only if the thread has ended, which it does at the end of the program or of the disk.
        let _ = self.0.send(TapEnd { ring: end, dropped });
    }
}

impl WireLogThread {
    /// Writes what waits, and ends the thread.
    pub(crate) fn finish(self) {
        self.ends.store(true, Ordering::Relaxed);
        let deadline = Instant::now() + END_WITHIN;
        while !self.thread.is_finished() && Instant::now() < deadline {
            std::thread::sleep(Duration::from_millis(1));
        }
    }
}

/// Writes the frames of all taps until `ends`, and then once more.
fn write_until(ends: &AtomicBool, new_taps: &mpsc::Receiver<TapEnd>, mut file: LogFile) {
    let mut taps: Vec<TapEnd> = Vec::new();
    loop {
        let last = ends.load(Ordering::Relaxed);
        taps.extend(new_taps.try_iter());
        for tap in &mut taps {
            let dropped = tap.dropped.swap(0, Ordering::Relaxed);
            if let Err(error) = file.drain(&mut tap.ring, dropped) {
                tracing::error!(
                    "the wire log {} ends: {error}: check the disk",
                    file.path.display()
                );
                return;
            }
        }
        taps.retain(|tap| !tap.ring.is_abandoned() || !tap.ring.is_empty());
        if last {
            return;
        }
        std::thread::sleep(DRAIN_PERIOD);
    }
}

/// The file, bounded.
struct LogFile {
    path: PathBuf,
    name: String,
    file: BufWriter<File>,
    bytes: u64,
    max_bytes: u64,
    /// Wall clock less monotonic clock, ns, read once: a clock that is set must not turn the log back.
    epoch_ns: u64,
}

impl LogFile {
    fn create(path: &Path, name: &str, max_bytes: u64) -> io::Result<LogFile> {
        let wall = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        Ok(LogFile {
            path: path.to_owned(),
            name: name.to_owned(),
            file: BufWriter::new(File::create(path)?),
            bytes: 0,
            max_bytes,
            epoch_ns: (wall.as_nanos() as u64).saturating_sub(now_ns()),
        })
    }

    fn drain(&mut self, ring: &mut rtrb::Consumer<Logged>, dropped: u64) -> io::Result<()> {
        while let Ok((at_ns, frame)) = ring.pop() {
            let line = line(self.epoch_ns + at_ns, &self.name, &frame);
            self.write(&line)?;
        }
        if dropped > 0 {
            tracing::warn!("the wire log lost {dropped} frames: the disk was too slow for them");
            let name = self.name.clone();
            self.write(&overflow_line(self.epoch_ns + now_ns(), &name))?;
        }
        self.file.flush()
    }

    fn write(&mut self, line: &str) -> io::Result<()> {
        if self.bytes + line.len() as u64 > self.max_bytes {
            self.file.flush()?;
            let mut old = self.path.clone().into_os_string();
            old.push(".old");
            std::fs::rename(&self.path, old)?;
            self.file = BufWriter::new(File::create(&self.path)?);
            self.bytes = 0;
        }
        self.bytes += line.len() as u64;
        self.file.write_all(line.as_bytes())
    }
}

/// One line of `candump -L`: `(1436509052.249713) can0 181#0011223344556677`.
fn line(wall_ns: u64, name: &str, frame: &Frame) -> String {
    let (s, us) = (wall_ns / NS_PER_S, wall_ns % NS_PER_S / 1000);
    let bytes: String = frame.bytes().iter().map(|byte| format!("{byte:02X}")).collect();
    format!("({s}.{us:06}) {name} {:03X}#{bytes}\n", frame.id)
}

/// The line of an error frame: controller problem, receive overflow. A comment would stop the tools of can-utils.
fn overflow_line(wall_ns: u64, name: &str) -> String {
    let (s, us) = (wall_ns / NS_PER_S, wall_ns % NS_PER_S / 1000);
    format!("({s}.{us:06}) {name} 20000004#0001000000000000\n")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::link::loopback;

    #[test]
    fn a_line_is_that_of_candump() {
        let frame = Frame::new(0x081, &[0x2A, 0x36, 0x6C, 0x2B, 0xBA]);
        assert_eq!(
            line(1_436_509_052_249_713_999, "vcan0", &frame),
            "(1436509052.249713) vcan0 081#2A366C2BBA\n"
        );
        assert_eq!(
            line(1_000, "mock", &Frame::new(0x701, &[])),
            "(0.000001) mock 701#\n"
        );
    }

    #[test]
    fn both_directions_are_logged_in_order_and_a_second_link_too() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("wire.log");
        let (log, thread) = WireLog::start(&path, "mock", 1 << 20).expect("writable");
        for round in 0..2u8 {
            let (mut host, mut rig) = loopback::pair();
            log.follow(&mut host);
            host.send(Frame::new(0x201, &[round]));
            assert!(rig.receive().is_some());
            rig.send(Frame::new(0x181, &[round, 1]));
            assert!(host.receive().is_some());
            assert!(host.receive().is_none());
            host.send_urgent(Frame::new(0x000, &[2, 1]));
        }
        thread.finish();
        let text = std::fs::read_to_string(&path).expect("written");
        let frames: Vec<&str> = text.lines().filter_map(|l| l.split(' ').nth(2)).collect();
        assert_eq!(
            frames,
            ["201#00", "181#0001", "000#0201", "201#01", "181#0101", "000#0201"]
        );
    }

    #[test]
    fn a_full_ring_drops_counts_and_says_so_and_the_sender_never_waits() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("wire.log");
        let mut file = LogFile::create(&path, "mock", 1 << 20).expect("writable");
        let (ring, mut end) = rtrb::RingBuffer::new(4);
        let dropped = Arc::new(AtomicU64::new(0));
        let mut tap = Tap {
            ring,
            dropped: Arc::clone(&dropped),
        };
        // Nobody reads.
        (0..10).for_each(|n| tap.take(&Frame::new(0x181, &[n])));
        assert_eq!(dropped.load(Ordering::Relaxed), 6);
        file.drain(&mut end, dropped.swap(0, Ordering::Relaxed))
            .expect("written");
        tap.take(&Frame::new(0x181, &[10]));
        file.drain(&mut end, dropped.swap(0, Ordering::Relaxed))
            .expect("written");
        let text = std::fs::read_to_string(&path).expect("written");
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), 6, "{text}");
        assert!(lines[4].ends_with(" mock 20000004#0001000000000000"), "{text}");
        assert!(lines[5].ends_with("181#0A"), "{text}");
    }

    #[test]
    fn the_log_never_takes_more_than_its_bound_and_keeps_the_newest() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("wire.log");
        let mut file = LogFile::create(&path, "mock", 500).expect("writable");
        for n in 0..200u8 {
            file.write(&line(u64::from(n), "mock", &Frame::new(0x181, &[n])))
                .expect("written");
        }
        file.file.flush().expect("written");
        let size = |path: &Path| path.metadata().expect("there").len();
        let old = folder.path().join("wire.log.old");
        assert!(size(&path) <= 500 && size(&old) <= 500);
        assert_eq!(std::fs::read_dir(folder.path()).expect("a folder").count(), 2);
        assert!(
            std::fs::read_to_string(&path)
                .expect("written")
                .ends_with("181#C7\n")
        );
    }

    /// `log2long` of can-utils reads the same format as `canplayer`, and needs no CAN.
    #[test]
    fn can_utils_read_the_log() {
        let frames: String = [
            Frame::new(0x181, &[1, 2, 3, 4, 5, 6, 7, 8]),
            Frame::new(0x000, &[2, 1]),
        ]
        .iter()
        .map(|frame| line(1_700_000_000_000_001_000, "can0", frame))
        .chain([overflow_line(1_700_000_000_000_002_000, "can0")])
        .collect();
        let ran = std::process::Command::new("log2long")
            .stdin(std::process::Stdio::piped())
            .stdout(std::process::Stdio::piped())
            .spawn();
        let Ok(mut tool) = ran else {
            eprintln!("SKIPPED: no log2long (Debian package can-utils)");
            return;
        };
        tool.stdin
            .take()
            .expect("piped")
            .write_all(frames.as_bytes())
            .expect("read");
        let output = tool.wait_with_output().expect("ends");
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(output.status.success(), "{text}");
        assert!(
            text.contains("181") && text.contains("01 02 03 04 05 06 07 08"),
            "{text}"
        );
        assert!(text.contains("02 01") && text.contains("ERRORFRAME"), "{text}");
    }
}
