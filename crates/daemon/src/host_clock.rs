//! Whether this computer's clock follows another one, by NTP or PTP, as the kernel tells it.
#![expect(unsafe_code, reason = "the kernel's own word on its clock is a call of C")]

use posed_protocol::HostClock;

/// What the kernel says of its clock; `None` where it does not answer.
#[cfg(target_os = "linux")]
pub(super) fn ask() -> Option<HostClock> {
    // SAFETY: all numbers, of which zeros are what changes nothing.
    let mut answer: libc::timex = unsafe { std::mem::zeroed() };
    // SAFETY: it fills in what it is given, and with `modes` 0 changes nothing.
    let state = unsafe { libc::adjtimex(&raw mut answer) };
    if state < 0 {
        return None;
    }
    let seconds = |us: libc::c_long| us as f64 * 1e-6;
    Some(HostClock {
        synchronised: state != libc::TIME_ERROR && answer.status & libc::STA_UNSYNC == 0,
        max_error_s: seconds(answer.maxerror),
        estimated_error_s: seconds(answer.esterror),
        tai_offset_s: (answer.tai != 0).then_some(answer.tai),
    })
}

/// Other kernels are not asked.
#[cfg(not(target_os = "linux"))]
pub(super) fn ask() -> Option<HostClock> {
    None
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    #[test]
    fn the_kernel_answers_with_numbers_that_may_be() {
        let clock = super::ask().unwrap();
        assert!(clock.max_error_s >= 0.0 && clock.estimated_error_s >= 0.0, "{clock:?}");
        assert!(clock.tai_offset_s.is_none_or(|tai| (10..100).contains(&tai)), "{clock:?}");
    }
}
