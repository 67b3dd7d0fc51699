# neurosym_jax for the CPU: docker build -t neurosym . && docker run --rm neurosym evaluate
FROM python:3.12-slim
WORKDIR /opt/neurosym_jax
COPY pyproject.toml setup.py MANIFEST.in README.md LICENSE ./
COPY checkpoints checkpoints
COPY neurosym_jax neurosym_jax
COPY neurosym_robot neurosym_robot
RUN pip install --no-cache-dir '.[robot]'
WORKDIR /work
ENTRYPOINT ["neurosym"]
CMD ["--help"]
