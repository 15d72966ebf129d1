# A robot and its page, at the address that it prints:
#   docker build -t softsim .
#   docker run --rm -it --hostname localhost -p 127.0.0.1:8080:8080 softsim
FROM python:3.12.12-slim-bookworm@sha256:593bd06efe90efa80dc4eee3948be7c0fde4134606dd40d8dd8dbcade98e669c

RUN useradd --create-home softsim && install -d -o softsim -g softsim /softsim /work
COPY --chown=softsim:softsim . /softsim
USER softsim
ENV PATH=/softsim/.softsim/venv/bin:$PATH PYTHONUNBUFFERED=1
RUN cd /softsim && ./softsim scenes && python -m softsim_core.simulation.warmup

WORKDIR /work
EXPOSE 8080
ENTRYPOINT ["softsim"]
CMD ["up", "tripod", "--host", "0.0.0.0"]
