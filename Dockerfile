# One image for a companion of either kind (amd64, arm64), and an extension of BlueOS at the same time:
#   docker buildx build --platform linux/amd64,linux/arm64 --tag spanwise .
# It runs the live service with its live view. Airframe, links and the rest are variables below; config/SETUP.md says how.
FROM python:3.11-slim-bookworm AS build
# Debian keeps one version of a package at a time: a pin would break the build at the next security update
# hadolint ignore=DL3008
RUN apt-get update && apt-get install --yes --no-install-recommends gcc libc6-dev && rm -rf /var/lib/apt/lists/*
WORKDIR /src
COPY requirements.lock pyproject.toml setup.py README.md LICENSE ./
COPY companion companion
COPY config config
# versions of the lock, without its extras for development
RUN sed -n 's/^\([A-Za-z0-9][^\\]*\).*/\1/p' requirements.lock > constraints.txt \
    && python -m venv /opt/spanwise \
    && /opt/spanwise/bin/pip install --no-cache-dir --constraint constraints.txt ".[oak,gpio,live]"

FROM python:3.11-slim-bookworm
# OAK cameras are reached by USB
# hadolint ignore=DL3008
RUN apt-get update && apt-get install --yes --no-install-recommends libusb-1.0-0 && rm -rf /var/lib/apt/lists/*
COPY --from=build /opt/spanwise /opt/spanwise
ENV PATH=/opt/spanwise/bin:$PATH \
    PYTHONUNBUFFERED=1 \
    DEPTHAI_TELEMETRY=0 \
    XDG_STATE_HOME=/data \
    SPANWISE_LINKS="--connect udpin:127.0.0.1:14551" \
    SPANWISE_AIRFRAME=/data/wing.toml \
    SPANWISE_CAMERAS="" \
    SPANWISE_TRIGGER="" \
    SPANWISE_MORE=""
VOLUME /data
EXPOSE 8765/tcp
HEALTHCHECK --interval=30s --timeout=5s --start-period=20s \
    CMD ["python", "-c", "import urllib.request as web; web.urlopen('http://127.0.0.1:8765/register_service', timeout=4)"]
# words of SPANWISE_LINKS, _CAMERAS, _TRIGGER and _MORE are options of their own, as in /etc/default/spanwise
ENTRYPOINT ["/bin/sh", "-c", "exec spanwise run --plain --live 0.0.0.0:8765 $SPANWISE_LINKS --airframe \"$SPANWISE_AIRFRAME\" $SPANWISE_CAMERAS $SPANWISE_TRIGGER $SPANWISE_MORE \"$@\"", "spanwise"]

LABEL org.opencontainers.image.title="Spanwise" \
      org.opencontainers.image.description="Stereo ranges that stay true while the wing bends" \
      org.opencontainers.image.licenses="Apache-2.0"
# what follows is read by BlueOS's manager of extensions
LABEL version="0.2.0"
LABEL type="device-integration"
LABEL requirements="core >= 1.1"
LABEL tags='["stereo", "rangefinder", "camera", "mavlink"]'
LABEL authors='[{"name": "The Spanwise developers"}]'
LABEL company='{"about": "", "name": "Spanwise"}'
LABEL links='{}'
# serial ports, USB, GPIO and cameras of the machine; its network, on which the autopilot's messages come; real-time priority
LABEL permissions='{\
  "HostConfig": {\
    "NetworkMode": "host",\
    "Privileged": true,\
    "CapAdd": ["SYS_NICE"],\
    "Binds": ["/usr/blueos/extensions/spanwise:/data", "/dev:/dev"]\
  }\
}'
