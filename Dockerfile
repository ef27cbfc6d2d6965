# The lab in a container; its parts are those that scripts/platform.sh tries on bare Debians:
#   docker build -t bullet_lab .
#   docker run --rm -v "$PWD/results:/home/student/results" bullet_lab squares
# With --build-arg SUITE=trixie on Debian 13. docs/platforms.md says what was tried.
ARG SUITE=bookworm
FROM debian:${SUITE}-slim
RUN apt-get update \
    && apt-get install --yes --no-install-recommends git sudo ca-certificates \
    && rm -rf /var/lib/apt/lists/* \
    && useradd --create-home --shell /bin/bash student \
    && echo "student ALL=(ALL) NOPASSWD: ALL" >/etc/sudoers.d/student
COPY --chown=student . /home/student/lab
USER student
WORKDIR /home/student
RUN lab/scripts/setup.sh
ENTRYPOINT ["/home/student/lab/scripts/run.sh"]
