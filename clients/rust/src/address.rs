//! What people type as the address of a daemon, as that of its websocket.

use tungstenite::http::Uri;

use super::Error;

const PORT: u16 = 8787;

/// `HOST`, `HOST:PORT`, the address of a page, or that of the websocket itself.
pub(super) fn websocket_of(address: &str) -> Result<String, Error> {
    let wrong = || Error::Address(address.to_owned());
    let is_plain = !address.contains("://");
    let whole = if is_plain { format!("ws://{address}") } else { address.to_owned() };
    let uri: Uri = whole.parse().map_err(|_| wrong())?;
    let authority = uri.authority().ok_or_else(wrong)?;
    if !matches!(uri.scheme_str(), Some("ws" | "http")) || authority.host().is_empty() {
        return Err(wrong());
    }
    let port = if is_plain && authority.port().is_none() { format!(":{PORT}") } else { String::new() };
    let path = uri.path();
    let path =
        if path.ends_with("/ws") { path.to_owned() } else { format!("{}/ws", path.trim_end_matches('/')) };
    let query = uri.query().map(|query| format!("?{query}")).unwrap_or_default();
    Ok(format!("ws://{authority}{port}{path}{query}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_people_type_is_an_address_and_what_is_none_is_refused() {
        for (given, websocket) in [
            ("127.0.0.1", "ws://127.0.0.1:8787/ws"),
            ("stage.local:80", "ws://stage.local:80/ws"),
            ("[::1]:8787", "ws://[::1]:8787/ws"),
            ("http://hub:8790/hall/", "ws://hub:8790/hall/ws"),
            ("http://hub/takes/a.mcap/#watch", "ws://hub/takes/a.mcap/ws"),
            ("ws://hub/ws?token=x", "ws://hub/ws?token=x"),
        ] {
            assert_eq!(websocket_of(given).unwrap(), websocket, "{given}");
        }
        for given in ["ftp://127.0.0.1", "https://hub/", "", "a b", "ws://"] {
            assert!(matches!(websocket_of(given), Err(Error::Address(_))), "{given}");
        }
    }
}
