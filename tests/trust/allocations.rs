//! The allocator of the test binary: the system's, and counts for each thread what it asks for.
#![allow(unsafe_code, reason = "an allocator cannot be written without")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

/// What one thread has asked for since it began.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Allocations {
    /// Calls that asked for memory; a change of size is one.
    pub count: u64,
    /// Calls that gave memory back.
    pub freed: u64,
    /// Bytes that the thread holds, less those that it freed for others.
    pub live_bytes: i64,
    /// The largest `live_bytes` since [`reset_peak`].
    pub peak_bytes: i64,
}

thread_local! {
    static OWN: Cell<Allocations> = const {
        Cell::new(Allocations { count: 0, freed: 0, live_bytes: 0, peak_bytes: 0 })
    };
}

/// The counts of the calling thread.
pub fn of_this_thread() -> Allocations {
    OWN.get()
}

/// Begins a new peak at what the calling thread holds now.
pub fn reset_peak() {
    let own = OWN.get();
    OWN.set(Allocations {
        peak_bytes: own.live_bytes,
        ..own
    });
}

fn note(count: u64, freed: u64, bytes: i64) {
    // A thread that ends may free memory after its counts are gone.
    let _ = OWN.try_with(|cell| {
        let own = cell.get();
        let live_bytes = own.live_bytes + bytes;
        cell.set(Allocations {
            count: own.count + count,
            freed: own.freed + freed,
            live_bytes,
            peak_bytes: own.peak_bytes.max(live_bytes),
        });
    });
}

struct Counting;

#[global_allocator]
static ALLOCATOR: Counting = Counting;

// SAFETY: every call goes to the system's allocator unchanged; counting neither allocates nor panics.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        note(1, 0, layout.size() as i64);
        // SAFETY: the caller's promises are those of the system's allocator.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        note(1, 0, layout.size() as i64);
        // SAFETY: as above.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, place: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        note(1, 0, size as i64 - layout.size() as i64);
        // SAFETY: as above.
        unsafe { System.realloc(place, layout, size) }
    }

    unsafe fn dealloc(&self, place: *mut u8, layout: Layout) {
        note(0, 1, -(layout.size() as i64));
        // SAFETY: as above.
        unsafe { System.dealloc(place, layout) }
    }
}

#[test]
fn a_box_is_one_allocation_of_its_size() {
    let before = of_this_thread();
    let boxed = std::hint::black_box(Box::new([0_u64; 16]));
    let with = of_this_thread();
    drop(boxed);
    let after = of_this_thread();
    assert_eq!(
        (with.count - before.count, with.live_bytes - before.live_bytes),
        (1, 128)
    );
    assert_eq!(
        (after.freed - with.freed, after.live_bytes),
        (1, before.live_bytes)
    );
}
