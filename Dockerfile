# docker build --tag halfseen .
# docker run --rm --network none --volume "$PWD:/work" halfseen inspect logs

FROM python:3.13-slim AS wheel
ENV PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_NO_CACHE_DIR=1
WORKDIR /source
COPY LICENSE README.md constraints.txt pyproject.toml ./
COPY src src
RUN PIP_BUILD_CONSTRAINT=constraints.txt python -m pip wheel --no-deps --wheel-dir dist .

FROM python:3.13-slim
# What it installs is what constraints.txt pins; nothing is downloaded when it runs.
ARG EXTRAS=perception,scene,study,onnx,serve
ENV PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_NO_CACHE_DIR=1 PYTHONUNBUFFERED=1
RUN --mount=type=bind,from=wheel,source=/source,target=/source \
    wheel=$(ls /source/dist/*.whl) && python -m pip install --constraint /source/constraints.txt "${wheel}[${EXTRAS}]" \
    && useradd --create-home --uid 1000 halfseen
USER 1000
WORKDIR /work
ENTRYPOINT ["halfseen"]
CMD ["--help"]
