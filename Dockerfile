# The service without the ray tracer, as an unprivileged user.
FROM python:3.12-slim AS build
WORKDIR /src
COPY requirements requirements
COPY pyproject.toml README.md LICENSE ./
COPY estimator estimator
COPY raytrace raytrace
COPY service service
COPY scenes scenes
RUN python -m venv /venv \
 && sed -E 's/ *\\$//; /^ *--hash/d; /^#/d' requirements/run.txt > constraints.txt \
 && /venv/bin/pip install --no-cache-dir -c constraints.txt .

FROM python:3.12-slim
RUN useradd --uid 10001 --create-home --home-dir /data hapslam
COPY --from=build /venv /venv
ENV PATH=/venv/bin:$PATH \
    HAPSLAM_HOST=0.0.0.0 \
    HAPSLAM_PORT=8600 \
    HAPSLAM_DATABASE_URL=sqlite:////data/hapslam.db
USER 10001
WORKDIR /data
VOLUME /data
EXPOSE 8600
STOPSIGNAL SIGTERM
HEALTHCHECK --start-period=10s CMD ["python", "-c", "import urllib.request as u; u.urlopen('http://127.0.0.1:8600/livez', timeout=3)"]
CMD ["hapslam", "serve"]
