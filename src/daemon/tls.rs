//! TLS for connections of other computers.

use std::path::Path;
use std::sync::Arc;

use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls::ServerConfig;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::pem::PemObject;
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};

use super::error::DaemonError;

/// Decrypts with the certificate chain and the private key of two PEM files. TLS 1.3 only: every browser of these years has it.
pub(super) fn acceptor(certificate: &Path, key: &Path) -> Result<TlsAcceptor, DaemonError> {
    let unusable = |path: &Path, source: Box<dyn std::error::Error + Send + Sync>| DaemonError::Tls {
        path: path.to_owned(),
        source,
    };
    let chain = CertificateDer::pem_file_iter(certificate)
        .and_then(Iterator::collect::<Result<Vec<_>, _>>)
        .map_err(|error| unusable(certificate, Box::new(error)))?;
    let private = PrivateKeyDer::from_pem_file(key).map_err(|error| unusable(key, Box::new(error)))?;
    let config = ServerConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()
        .and_then(|builder| builder.with_no_client_auth().with_single_cert(chain, private))
        .map_err(|error| unusable(certificate, Box::new(error)))?;
    Ok(TlsAcceptor::from(Arc::new(config)))
}
