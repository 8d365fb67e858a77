# The service alone: base install, no torch, an unprivileged user.
#
#   docker build -t physnet .
#   docker run --rm --read-only -v physnet-kernels:/var/cache/physnet -p 8000:8000 -p 8001:8001 physnet

FROM python:3.12-slim AS build
WORKDIR /src
RUN python -m venv /opt/physnet
# What the wheel is made of, and nothing else: a change to tests or documents rebuilds nothing.
COPY pyproject.toml README.md LICENSE ./
COPY models models
COPY training training
COPY service service
# Further extras, such as `tracing`: --build-arg EXTRAS=tracing
ARG EXTRAS=
RUN /opt/physnet/bin/pip install --no-cache-dir --disable-pip-version-check ".${EXTRAS:+[$EXTRAS]}"

FROM python:3.12-slim
COPY --from=build /opt/physnet /opt/physnet
RUN useradd --system --uid 10001 --no-create-home physnet
RUN install --directory --owner=physnet /var/cache/physnet
USER physnet
ENV PATH=/opt/physnet/bin:$PATH \
    PYTHONUNBUFFERED=1 \
    PYTHONDONTWRITEBYTECODE=1 \
    NUMBA_CACHE_DIR=/var/cache/physnet \
    PHYSNET_HOST=0.0.0.0 \
    PHYSNET_LOG_FORMAT=json \
    PHYSNET_HTTP_PORT=8000 \
    PHYSNET_GRPC_PORT=8001
EXPOSE 8000 8001
# A prediction, so that the image holds the kernels it takes, compiled for the kind of processor it is built on. On
# another kind they are compiled at the first start. Numba wants to write where it reads: a new volume begins with what
# is here, and a named one keeps what was added.
RUN ["physnet", "doctor"]
VOLUME /var/cache/physnet
# /healthz answers as soon as the process lives; whether the models are warm is for /readyz and the orchestrator.
HEALTHCHECK --interval=10s --timeout=3s --start-period=20s --retries=3 \
    CMD ["python", "-c", "import os, urllib.request as r; r.urlopen(f'http://127.0.0.1:{os.environ[\"PHYSNET_HTTP_PORT\"]}/healthz', timeout=2)"]
ENTRYPOINT ["physnet"]
CMD ["serve"]
