//! Tokens, roles, origins, hosts, TLS, plain HTTP.

use std::io::Read;
use std::sync::Arc;

use flate2::read::GzDecoder;
use posed_daemon::server::{BindError, Server};
use serde_json::json;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio_rustls::rustls;

use super::harness::{OPERATE, Running, WATCH, config, get, get_bytes, stage, start};

fn with_tokens() -> Running {
    let tokens = format!(
        r#"
        [[server.token]]
        secret = "{WATCH}"
        role = "watch"
        [[server.token]]
        secret = "{OPERATE}"
        role = "operate"
        "#
    );
    start(&stage(&tokens), config())
}

#[tokio::test]
async fn without_a_token_only_loopback() {
    let open = posed_daemon::server::Config { listen: Some("0.0.0.0:0".into()), ..config() };
    match Server::bind(&stage(""), open.clone()) {
        Err(error @ BindError::NeedsToken { .. }) => assert!(error.to_string().contains("[[server.token]]")),
        Err(error) => panic!("{error}"),
        Ok(_) => panic!("it was not refused"),
    }
    let tokens = format!("[[server.token]]\nsecret = \"{WATCH}\"\nrole = \"watch\"");
    assert!(Server::bind(&stage(&tokens), open).is_ok());
}

#[tokio::test]
async fn a_taken_port_is_named() {
    let server = Running::plain();
    let taken = posed_daemon::server::Config { listen: Some(server.address.to_string()), ..config() };
    match Server::bind(&stage(""), taken) {
        Err(error @ BindError::Bind { .. }) => {
            assert!(error.to_string().contains(&server.address.to_string()))
        }
        Err(error) => panic!("{error}"),
        Ok(_) => panic!("it was not refused"),
    }
}

#[tokio::test]
async fn tokens_and_roles() {
    let server = with_tokens();
    assert_eq!(server.refusal(server.request("")).await.0, 401);
    assert_eq!(server.refusal(server.request("?token=wrong")).await.0, 401);
    let mut request = server.request("");
    request.headers_mut().insert("authorization", format!("Bearer {WATCH}").parse().unwrap());
    let mut watcher = server.connect(request).await.unwrap();
    assert_eq!(watcher.next().await["role"], "watch");
    watcher.subscribe(&["sensors"]).await;
    let reply = watcher.ask(json!({"type": "record.start"})).await;
    assert_eq!((&reply["type"], &reply["code"]), (&json!("error"), &json!("forbidden")));
    let operator = server.connect(server.request(&format!("?token={OPERATE}"))).await;
    assert_eq!(operator.unwrap().next().await["role"], "operate");
    let open = "GET /metrics HTTP/1.1\r\nHost: localhost\r\n\r\n";
    assert!(get(server.address, open).await.starts_with("HTTP/1.1 401"));
}

#[tokio::test]
async fn foreign_origins_get_403_and_foreign_hosts_421() {
    let server = Running::plain();
    let with = |name: &'static str, value: &str| {
        let mut request = server.request("");
        request.headers_mut().insert(name, value.parse().unwrap());
        request
    };
    let (status, sentence) = server.refusal(with("origin", "https://evil.example")).await;
    assert_eq!(status, 403);
    assert!(sentence.contains("allowed_origins"), "{sentence}");
    assert_eq!(server.refusal(with("host", "evil.example")).await.0, 421);
    let own = format!("http://{}", server.address);
    assert!(server.connect(with("origin", &own)).await.is_ok());
}

#[tokio::test]
async fn page_health_and_metrics() {
    let server = Running::plain();
    let mut client = server.client().await;
    client.subscribe(&["sensors"]).await;
    server.frame(1);
    client.next().await;
    let ask = |path: &str| {
        let head = format!("GET {path} HTTP/1.1\r\nHost: {}\r\n\r\n", server.address);
        async move { get(server.address, &head).await }
    };
    assert!(ask("/health").await.ends_with("\r\n\r\nok\n"));
    let page = ask("/").await;
    assert!(page.starts_with("HTTP/1.1 200"));
    assert!(page.contains("content-security-policy: default-src 'none'"), "{page}");
    assert!(page.contains("<html lang"), "{page}");
    // The viewer's files, where it was built; without npm the page states what is missing.
    let assets = page.split('"').filter(|word| word.starts_with("./assets/"));
    for asset in assets.clone() {
        let file = ask(&asset[1..]).await;
        let kind = if asset.ends_with(".js") { "text/javascript" } else { "text/css" };
        assert!(file.starts_with("HTTP/1.1 200") && file.contains(kind), "{asset}");
        // As browsers ask for it: compressed, once.
        let path = &asset[1..];
        let head =
            format!("GET {path} HTTP/1.1\r\nHost: {}\r\nAccept-Encoding: gzip, br\r\n\r\n", server.address);
        let answer = get_bytes(server.address, &head).await;
        let at = answer.windows(4).position(|four| four == b"\r\n\r\n").unwrap() + 4;
        let head = str::from_utf8(&answer[..at]).unwrap();
        assert!(head.contains("content-encoding: gzip") && head.contains("immutable"), "{head}");
        let mut text = String::new();
        GzDecoder::new(&answer[at..]).read_to_string(&mut text).unwrap();
        assert!(file.ends_with(&text) && !text.is_empty() && !file.contains("content-encoding"), "{asset}");
    }
    assert!(page.contains("cache-control: no-store"), "{page}");
    assert!(assets.count() >= 2 || page.contains("no viewer page"), "{page}");
    assert!(ask("/assets/none.js").await.starts_with("HTTP/1.1 404"));
    assert!(ask("/assets/..%2Findex.html").await.starts_with("HTTP/1.1 404"));
    assert!(ask("/etc/passwd").await.starts_with("HTTP/1.1 404"));
    let metrics = ask("/metrics").await;
    for line in ["posed_clients 1", "posed_frames_total 1", "posed_messages_total 1"] {
        assert!(metrics.lines().any(|l| l == line), "{line} in {metrics}");
    }
    let samples = metrics.split("\r\n\r\n").nth(1).unwrap().lines().filter(|line| !line.starts_with('#'));
    assert!(samples.clone().count() > 5 && samples.clone().all(|line| line.starts_with("posed_")));
}

#[tokio::test]
async fn tls_by_the_stage_files_certificate() {
    let folder = tempfile::tempdir().unwrap();
    let rcgen::CertifiedKey { cert, signing_key } =
        rcgen::generate_simple_self_signed(vec!["localhost".to_owned()]).unwrap();
    std::fs::write(folder.path().join("cert.pem"), cert.pem()).unwrap();
    std::fs::write(folder.path().join("key.pem"), signing_key.serialize_pem()).unwrap();
    let tls = "[server.tls]\ncertificate = \"cert.pem\"\nkey = \"key.pem\"";
    let config = posed_daemon::server::Config { folder: folder.path().into(), ..config() };
    let server = start(&stage(tls), config.clone());
    assert!(server.url.starts_with("https://"));

    let mut roots = rustls::RootCertStore::empty();
    roots.add(cert.der().clone()).unwrap();
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let client = rustls::ClientConfig::builder_with_provider(provider)
        .with_safe_default_protocol_versions()
        .unwrap()
        .with_root_certificates(roots)
        .with_no_client_auth();
    let tcp = tokio::net::TcpStream::connect(server.address).await.unwrap();
    let name = "localhost".try_into().unwrap();
    let mut stream = tokio_rustls::TlsConnector::from(Arc::new(client)).connect(name, tcp).await.unwrap();
    stream.write_all(b"GET /health HTTP/1.1\r\nHost: localhost\r\n\r\n").await.unwrap();
    let mut answer = String::new();
    let _ = stream.read_to_string(&mut answer).await;
    assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");

    std::fs::write(folder.path().join("key.pem"), "no key").unwrap();
    match Server::bind(&stage(tls), config) {
        Err(BindError::Tls(error)) => assert!(error.to_string().contains("key.pem"), "{error}"),
        Err(error) => panic!("{error}"),
        Ok(_) => panic!("it was not refused"),
    }
}
