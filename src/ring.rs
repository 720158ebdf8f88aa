//! Rings between threads, with their memory in place.

use rtrb::{Consumer, Producer, RingBuffer};

/// An empty ring whose pages were all written once, with items of `filler`: the first write to a page of fresh memory is a page fault,
/// and the control thread must meet none.
pub(crate) fn touched<T>(places: usize, filler: impl Fn() -> T) -> (Producer<T>, Consumer<T>) {
    let (mut input, mut output) = RingBuffer::new(places);
    while input.push(filler()).is_ok() {}
    while output.pop().is_ok() {}
    (input, output)
}

#[cfg(test)]
mod tests {
    use nix::sys::resource::{UsageWho, getrusage};

    use super::*;

    fn page_faults() -> i64 {
        getrusage(UsageWho::RUSAGE_THREAD)
            .expect("Linux knows it")
            .minor_page_faults()
    }

    /// Faults of writing to each place of a ring once.
    fn faults_of_first_round((mut input, mut output): (Producer<u64>, Consumer<u64>)) -> i64 {
        let before = page_faults();
        while input.push(1).is_ok() {}
        let faults = page_faults() - before;
        while output.pop().is_ok() {}
        faults
    }

    #[test]
    fn the_first_round_of_a_touched_ring_meets_no_page_fault() {
        // 64 MB: above 32 MB the allocator never hands out memory that was used before.
        const PLACES: usize = 1 << 23;
        assert!(faults_of_first_round(RingBuffer::new(PLACES)) > 0, "fresh memory");
        assert_eq!(faults_of_first_round(touched(PLACES, || 0)), 0);
    }

    #[test]
    fn a_touched_ring_is_empty_and_holds_all_its_places() {
        let (mut input, mut output) = touched(3, || 0);
        assert!(output.pop().is_err());
        assert!((1..=3).all(|item| input.push(item).is_ok()) && input.push(4).is_err());
        assert_eq!(output.pop(), Ok(1));
    }
}
