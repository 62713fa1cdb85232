"""Brokers, and secrets from the environment or files."""

from __future__ import annotations

import ipaddress
import os
import re
import ssl
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Self

from pydantic import AfterValidator, Field, field_validator, model_validator

from pmfid.config.toml_file import FileSection
from pmfid.errors import UsageError
from pmfid.service.tuning import TUNING

if TYPE_CHECKING:
    from paho.mqtt.client import Client


def is_here(host: str) -> bool:
    """Return whether the host is the local machine."""
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return host == "localhost"


def is_place(text: str) -> bool:
    """Return whether a text names the place of a secret, which is "env:NAME" or "file:NAME"."""
    return re.fullmatch("(env|file):.+", text) is not None


def _check_place(text: str) -> str:
    if not is_place(text):
        raise ValueError("the secret itself must not stand in this file")
    return text


Text = Annotated[str, Field(min_length=1)]
#: The place of a secret.
Place = Annotated[str, AfterValidator(_check_place)]
#: Words that describe a place.
PLACE = 'as "env:NAME" or "file:NAME"'


def read_secret(place: str, folder: Path) -> str:
    """Return the password or token from its place. Names of files are relative to `folder`.

    Raises UsageError for a missing secret, and for a file that everybody can read.
    """
    kind, _, name = place.partition(":")
    if kind == "env":
        if name not in os.environ:
            raise UsageError(
                f"the environment variable {name} is not set; set it to the secret, or use a file for the secret"
            )
        return os.environ[name]
    path = folder / name
    try:
        with path.open(encoding="utf-8") as stream:
            if os.name == "posix" and os.fstat(stream.fileno()).st_mode & stat.S_IROTH:
                raise UsageError(f"everybody on this machine can read the secret in {path}; run: chmod 600 {path}")
            return stream.read().rstrip("\r\n")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not plain text"
        raise UsageError(
            f"the secret in {path} cannot be read: {reason}; correct the file name or its permissions"
        ) from None


#: Ports of a broker, without and with TLS.
PORT, TLS_PORT = 1883, 8883


class BrokerSection(FileSection):
    """Keys of a section that names a broker."""

    host: Text = Field("127.0.0.1", description="the host name or address of the broker")
    port: int | None = Field(
        None, ge=1, le=65535, description=f"the port of the broker; by default {PORT}, or {TLS_PORT} with TLS"
    )
    keepalive: int = Field(
        60, ge=5, le=65535, description="the time in s after which a connection without any data counts as lost"
    )
    user: Text | None = Field(None, description="the user name at the broker; leave it out for a broker without users")
    password: Place | None = Field(None, repr=False, description=f"the place of the password, {PLACE}")
    allow_plain_password: bool = Field(
        False, description="true to send the password unencrypted to another host, without TLS"
    )
    tls: bool = Field(False, description="true for TLS with the certificates that the operating system trusts")
    ca: Text | None = Field(
        None,
        description=(
            "the file of the certificates to trust instead of those of the system; this key also turns TLS on"
        ),
    )
    cert: Text | None = Field(None, description="the file of this client's own certificate, together with key")
    key: Text | None = Field(None, description="the file with the private key of the certificate in cert")

    @field_validator("host")
    @classmethod
    def _only_a_name(cls, host: str) -> str:
        """Refuse an address with other parts, which would be looked up for ever as an unknown name."""
        if "/" in host or any(mark.isspace() for mark in host):
            raise ValueError(
                "the host must be a name or an address without mqtt:// and without a path; for TLS set tls = true"
            )
        if host.count(":") == 1:
            raise ValueError("the host must be a name or an address without a port; give the port in the key port")
        return host

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if self.password and not self.user:
            raise ValueError("a password is given without a user; add the key user")
        if bool(self.cert) != bool(self.key):
            raise ValueError("cert and key belong together; give both, or neither")
        clear = self.password and not (self.encrypted or is_here(self.host))
        if clear and not self.allow_plain_password:
            raise ValueError(
                f"the password would reach {self.host} unencrypted; set tls = true, or set ca to the file of "
                "the broker's certificate authority; allow_plain_password = true accepts the risk"
            )
        return self

    @property
    def encrypted(self) -> bool:
        return self.tls or self.ca is not None or self.cert is not None

    @property
    def address(self) -> tuple[str, int]:
        return self.host, self.port or (TLS_PORT if self.encrypted else PORT)


def new_client(section: BrokerSection, folder: Path, name: str, *, acknowledges: bool = False) -> Client:
    """Return a client of MQTT 5 that is not connected yet, and connects once.

    The client acknowledges messages by itself, or leaves this to the receiver of its messages if `acknowledges` is set.
    Names of files are relative to `folder`. Raises UsageError without paho-mqtt, and for certificates or a password
    that cannot be read.
    """
    try:
        from paho.mqtt import client as mqtt
        from paho.mqtt.enums import CallbackAPIVersion
    except ImportError:
        raise UsageError("MQTT needs paho-mqtt: pip install 'pmfid[serve]'") from None
    client = mqtt.Client(
        CallbackAPIVersion.VERSION2, name, protocol=mqtt.MQTTv5, reconnect_on_failure=False, manual_ack=acknowledges
    )
    client.connect_timeout = TUNING.answer
    if section.user is not None:
        client.username_pw_set(section.user, section.password and read_secret(section.password, folder))
    if section.encrypted:
        try:
            context = ssl.create_default_context(cafile=None if section.ca is None else str(folder / section.ca))
            if section.cert is not None and section.key is not None:
                context.load_cert_chain(folder / section.cert, folder / section.key)
        except OSError as error:  # includes ssl.SSLError
            problem = f"the certificates for the broker cannot be used ({error})"
            raise UsageError(f"{problem}; correct the keys ca, cert and key") from None
        client.tls_set_context(context)
    return client


def pauses(longest: float | None = None) -> Iterator[float]:
    """Yield the pause [s] before each attempt after a failure.

    Each pause is twice the previous one, up to `longest`, by default `longest_pause`.
    """
    pause, longest = TUNING.first_pause, longest or TUNING.longest_pause
    while True:
        yield pause
        pause = min(2 * pause, longest)
