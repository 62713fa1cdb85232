"""Alarms to a web server: a POST with JSON for each."""

from __future__ import annotations

from hashlib import sha256
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from pmfid.errors import UsageError, did_you_mean
from pmfid.service.secrets import secret
from pmfid.service.sinks.plain import as_json, notice_object
from pmfid.service.sinks.posting import Poster, check_address
from pmfid.service.sinks.section import Host, SinkSection
from pmfid.session.model_config import Name, Positive
from pmfid.stream.outcome import EstimateRows, Notice

__all__ = ["WebhookSection", "WebhookSink"]

#: All events of a service: a misspelt event would never be sent.
EVENTS = (
    *(
        "alarm",
        "acknowledged",
        "settled",
        "cleared",
        "state",
        "outlier",
        "gap",
        "clock",
        "epoch",
        "period",
        "late",
        "duplicate",
    ),
    *("unusable", "bad line", "repeated line", "reference", "anew", "source", "sink", "dropped", "checkpoint"),
    *("configuration", "calibration", "reload", "serving", "paused", "ended"),
)
#: Notices that are remembered as delivered, while others of the same time are tried again.
REMEMBERED = 2048


def _check_events(events: tuple[str, ...]) -> tuple[str, ...]:
    for event in events:
        if event not in EVENTS:
            raise ValueError(f"there is no event {event!r}; there are {', '.join(EVENTS)}{did_you_mean(event, EVENTS)}")
    return events


class WebhookSection(SinkSection):
    """[sinks.NAME] with kind = "webhook"."""

    kind: Literal["webhook"] = Field("webhook", description='"webhook"')
    url: Name | None = Field(None, description='the address, as "https://example.org/alarms"')
    url_env: Name | None = Field(None, description="the environment variable with the address, where that is a secret")
    url_file: Name | None = Field(None, description="the file with the address, where that is a secret")
    # not strict, because TOML has lists and a frozen object wants a tuple
    events: Annotated[tuple[Name, ...], Field(strict=False, min_length=1), AfterValidator(_check_events)] = Field(
        ("alarm", "cleared"), description='the events that are sent, as ["alarm", "settled", "acknowledged"]'
    )
    secret_header: Annotated[str, Field(pattern=r"^[A-Za-z0-9-]{1,100}$")] = Field(
        "Authorization", description='the name of the header with the secret, "Authorization" if left out'
    )
    secret_env: Name | None = Field(None, description="the environment variable with the whole value of that header")
    secret_file: Name | None = Field(None, description="the file with the whole value of that header")
    timeout_s: Positive = Field(5.0, description="the time in s for a whole exchange, for example 5.0")
    ca: Name | None = Field(None, description="the file of certificates that are trusted, or leave it out")

    @model_validator(mode="after")
    def _one_address(self) -> Self:
        if sum(one is not None for one in (self.url, self.url_env, self.url_file)) != 1:
            raise ValueError("give the address by one of url, url_env and url_file")
        if self.secret_env and self.secret_file:
            raise ValueError("secret_env and secret_file are both there; give one of them")
        return self

    def wants_rows(self) -> bool:
        """Events alone."""
        return False

    def wants_events(self) -> frozenset[str] | None:
        """Those that are configured."""
        return frozenset(self.events)

    def make(self, name: str, context: Host) -> WebhookSink:
        """The sink, not yet open. Raises UsageError for an address or a secret that is none."""
        label, folder = f"[sinks.{name}]", context.folder
        url = self.url or secret(self.url_env, self.url_file, folder)
        if url is None:
            raise UsageError(f"{label} url is missing; give the address")
        value = secret(self.secret_env, self.secret_file, folder)
        address = check_address(url.strip(), value, label)
        headers = {"User-Agent": "pmfid"} | ({} if value is None else {self.secret_header: value})
        ca = None if self.ca is None else folder / Path(self.ca)
        return WebhookSink(name, context.name, Poster(address, headers, self.timeout_s, ca))


class WebhookSink:
    """Each notice that is put goes out once as long as this process lives, and once more where it comes again after a
    restart: then with the same `Idempotency-Key`."""

    def __init__(self, name: str, service: str, poster: Poster) -> None:
        self.name = name
        self._service, self._poster = service, poster
        self._delivered: dict[str, None] = {}

    def open(self) -> None:
        """Nothing: it connects when there is something to say."""

    def put(self, outcomes: list[EstimateRows | Notice]) -> None:
        """Raises OSError where the server does not answer or has a problem, RefusedError where it will not take one."""
        try:
            for notice in outcomes:
                if isinstance(notice, Notice):
                    self._send(notice)
        finally:
            self._poster.close()

    def _send(self, notice: Notice) -> None:
        key = sha256(as_json([self._service, notice.axis, notice.number, notice.what]).encode()).hexdigest()[:32]
        if key in self._delivered:
            return
        body = as_json({"service": self._service, **notice_object(notice)}).encode()
        self._poster.post(body, {"Content-Type": "application/json", "Idempotency-Key": key})
        self._delivered[key] = None
        while len(self._delivered) > REMEMBERED:
            del self._delivered[next(iter(self._delivered))]

    def close(self) -> None:
        """Ends the connection."""
        self._poster.close()
