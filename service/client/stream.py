"""Streams of frames for threads: hand frames in as they come, read answers as they come; the newest frame wins."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Iterator
from types import TracebackType
from typing import Unpack

import grpc

from service.api.generated import deformation_pb2 as pb
from service.client import grpc_wire
from service.client.errors import ServiceUnreachable
from service.client.frames import Answer, Counts, Frame, FrameBook
from service.client.grpc_transport import GrpcTransport
from service.client.question import Camera, Depth, Earlier, MaterialLike, Options, Push, Question, Shape, question
from service.client.result import Result
from service.client.retry import Retry
from service.core.errors import PhysNetError


class FrameStream:
    """A stream of frames. `send` never waits; iterate, in this thread or another, for the answers.

    A context manager: leaving it waits for the answers that are still due, unless by an exception.

    Args:
        carry: Takes frames and settles them until there are no more, in a thread of its own.
        book: Of the frames.
    """

    def __init__(self, carry: Callable[[FrameStream], None], book: FrameBook) -> None:
        self._book = book
        self._changed = threading.Condition()
        self._closed = False
        self._broken = False
        self._reason: PhysNetError | None = None
        self._hang_up: Callable[[], object] = lambda: None
        self._era = 0
        self._thread = threading.Thread(target=self._run, args=(carry,), name="physnet-stream", daemon=True)
        self._thread.start()

    # --- the robot's side

    def send(
        self,
        depth: Depth | Shape | Earlier,
        camera: Camera | None = None,
        push: Push | Iterable[Push] = (),
        material: MaterialLike = "silicone",
        *,
        frame_id: int | None = None,
        **options: Unpack[Options],
    ) -> int:
        """Hand a frame in; a frame that still waits to be sent is overtaken by it.

        Args:
            depth: See `service.client.question.question`, as for the next three.
            camera: Intrinsics.
            push: One load or several.
            material: Name or numbers.
            frame_id: Greater than that of the frame before, such as a time stamp; counted where absent.
            options: See `service.client.question.Options`.

        Returns:
            The frame's id.

        Raises:
            ValueError: An id that does not rise, or an array that is no image.
            ServiceUnreachable: The stream is closed, or broke for good.
        """
        return self.ask(question(depth, camera, push, material, **options), frame_id)

    def ask(self, asked: Question, frame_id: int | None = None) -> int:
        """`send` for a question that is complete."""
        with self._changed:
            if self._closed or self._broken:
                raise ServiceUnreachable("The stream is closed.")
            number = self._book.add(asked, frame_id).frame_id
            self._changed.notify_all()
        return number

    def __iter__(self) -> Iterator[Answer]:
        """Answers as they come, until the stream is closed and the last is there.

        Raises:
            PhysNetError: The stream broke for good; a connection that breaks is opened again.
        """
        while (answer := self.next()) is not None:
            yield answer

    def next(self, timeout_s: float | None = None) -> Answer | None:
        """The next answer; None when the stream has ended, or none came in time. Raises as iterating does."""
        with self._changed:
            self._changed.wait_for(lambda: self._book.answers or self._ended, timeout_s)
            if self._book.answers:
                return self._book.answers.popleft()
            if self._reason is not None:
                raise self._reason
            return None

    def latest(self, timeout_s: float | None = None) -> Answer | None:
        """The newest answer there is, dropping older ones; waits for one where there is none. Else as `next`."""
        with self._changed:
            answer = self.next(timeout_s)
            while self._book.answers:
                answer = self._book.answers.popleft()
                self._book.counts.dropped += 1
        return answer

    def counts(self) -> Counts:
        """What became of the frames so far."""
        with self._changed:
            return Counts(**vars(self._book.counts))

    def close(self, *, drain: bool = True, timeout_s: float = 10.0) -> None:
        """Send no more frames. With `drain` the answers still due are waited for, else given up."""
        with self._changed:
            self._closed = True
            if not drain:
                self._broken = True
                self._book.lose(ServiceUnreachable("The stream was closed."), waiting_too=True)
                self._hang_up()
            self._changed.notify_all()
        self._thread.join(timeout_s)

    def __enter__(self) -> FrameStream:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close(drain=kind is None)

    @property
    def _ended(self) -> bool:
        return self._broken or (self._closed and self._book.idle)

    # --- the wire's side

    def take(self, era: int) -> Frame | None:
        """The newest frame, once there is one and room for it; None when the stream or this era of it is over."""
        with self._changed:
            while era == self._era and not self._broken:
                frame = self._book.next()
                if frame is not None:
                    return frame
                if self._closed and not self._book.waits:
                    return None
                self._changed.wait()
            return None

    def settle(self, answer: Answer) -> None:
        """What became of a frame that was taken."""
        with self._changed:
            self._book.done(answer)
            self._changed.notify_all()

    def begin_era(self, error: PhysNetError | None = None) -> int:
        """A new connection; what was under way on the one before is lost by `error`."""
        with self._changed:
            if error is not None:
                self._book.lose(error)
            self._era += 1
            self._changed.notify_all()
            return self._era

    def connected(self, hang_up: Callable[[], object]) -> None:
        """How to end the connection of this era at once."""
        with self._changed:
            self._hang_up = hang_up
            if self._broken:
                hang_up()

    def rest(self, pause_s: float) -> None:
        """Wait before the next connection, unless the stream is closed meanwhile."""
        with self._changed:
            self._changed.wait_for(lambda: self._ended, pause_s)

    @property
    def over(self) -> bool:
        """Whether no frame is to come and none is due."""
        with self._changed:
            return self._ended

    def _run(self, carry: Callable[[FrameStream], None]) -> None:
        reason: PhysNetError | None = None
        try:
            carry(self)
        except PhysNetError as error:
            reason = error
        except Exception as error:
            reason = ServiceUnreachable(f"The stream broke: {error!r}")
            raise
        finally:
            with self._changed:
                if not self._broken and reason is not None:
                    self._reason = reason
                    self._book.lose(reason, waiting_too=True)
                self._broken = True
                self._changed.notify_all()


def carry_by_calls(ask: Callable[[Question], Result]) -> Callable[[FrameStream], None]:
    """Streams where there is no wire, or one without streams: one question after the other, about the newest frame."""

    def carry(stream: FrameStream) -> None:
        era = stream.begin_era()
        while (frame := stream.take(era)) is not None:
            try:
                answer = Answer(frame.frame_id, result=ask(frame.question))
            except PhysNetError as error:
                answer = Answer(frame.frame_id, error=error)
            stream.settle(answer)

    return carry


def carry_by_grpc(
    transport: GrpcTransport, retry: Retry, deadline_s: float | None
) -> Callable[[FrameStream], None]:
    """One gRPC stream, opened again where it breaks; `deadline_s` is each frame's, in the service."""

    def messages(stream: FrameStream, era: int) -> Iterator[pb.DeformStreamRequest]:
        while (frame := stream.take(era)) is not None:
            yield grpc_wire.stream_request(frame, deadline_s)

    def carry(stream: FrameStream) -> None:
        tried = 0
        error: PhysNetError | None = None
        while not stream.over:
            call = transport.stream(messages(stream, stream.begin_era(error)))
            stream.connected(call.cancel)
            try:
                for response in call:
                    tried = 0
                    stream.settle(grpc_wire.stream_answer(response))
                error = ServiceUnreachable("The service has ended the stream.")
            except grpc.RpcError as failed:
                error = grpc_wire.error_of(failed, None)
            if not stream.over:
                tried += 1
                stream.rest(patience.pause_or_raise_s(tried, error))

    patience = retry.without_end()
    return carry
