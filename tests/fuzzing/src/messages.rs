//! What clients of a stage and of a hub send.

/// Whatever a client sends is a request or an error; a request survives being written and read again. At a hub the same bytes are
/// a request with stages beside it, or an error.
pub(crate) fn client(data: &[u8]) {
    posed_protocol::fuzz_client_message(data);
    posed_daemon::server::fuzz_hub_message(data);
}
