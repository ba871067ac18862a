//! Virtual trackers: truth in, device bytes out.
