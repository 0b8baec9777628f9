# One image for API, scheduler, worker and migration: both wheels with exactly the locked dependencies.
# BASE is any image with `python` 3.11 or newer and a pip that installs.
ARG BASE=python:3.11-slim
FROM ${BASE} AS build
WORKDIR /src
COPY . .
RUN pip install --no-cache-dir uv==0.13.9 \
    && uv build --wheel --out-dir /wheel \
    && uv build --wheel --out-dir /wheel wheels/server \
    && uv build --wheel --out-dir /wheel wheels/twin \
    && uv build --wheel --out-dir /wheel wheels/paper \
    && uv venv /venv \
    && uv pip install --python /venv/bin/python --constraints requirements.lock \
        "$(ls /wheel/lbacal-*.whl)[dask]" /wheel/lbacal_server-*.whl

FROM ${BASE}
RUN useradd --system --create-home --home-dir /data lbacal
COPY --from=build /venv /venv
ENV PATH=/venv/bin:$PATH OPENBLAS_NUM_THREADS=1
USER lbacal
WORKDIR /data
EXPOSE 8000
ENTRYPOINT ["lbacal"]
CMD ["serve", "--host", "0.0.0.0"]
