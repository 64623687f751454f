#!/bin/sh
# Starts a service once its keys are there: in a composition that starts from nothing they are being made just now.
# No `depends_on` does that, as podman never starts a container again whose dependency has ended.
trap 'exit 0' TERM INT
there() {
  [ -f "$MOTIONLOOP_CURVE_DIR/server.key" ] && [ -f "$MOTIONLOOP_CURVE_DIR/client.key" ] \
    && ls "$MOTIONLOOP_CURVE_DIR"/*.key_secret >/dev/null 2>&1
}
looks=0
# After a minute the service itself says what is missing.
while [ -n "$MOTIONLOOP_CURVE_DIR" ] && [ "$looks" -lt 300 ] && ! there; do
  looks=$((looks + 1))
  sleep 0.2
done
trap - TERM INT
exec "$@"
