# The program cosim with the parallel robot and its FMUs, without a compiler:
#   docker build -t cosim .
#   docker run --rm -v "$PWD/results:/home/cosim/results" cosim     the closed loop of the paper
#   docker run --rm -v "$PWD:/home/cosim" cosim run my.fmu          an FMU of yours, for Linux

FROM python:3.13 AS build
WORKDIR /src
COPY . .
RUN pip wheel --no-cache-dir --quiet --wheel-dir /wheels ".[robot]" \
    && pip install --no-cache-dir --quiet --no-index --find-links /wheels "closed-chain-cosim[robot]" \
    && python build_fmus.py --flavour fmi2 --flavour fmi3 --fmus /fmus

FROM python:3.13-slim
RUN --mount=type=bind,from=build,source=/wheels,target=/wheels \
    pip install --no-cache-dir --quiet --no-index --find-links /wheels "closed-chain-cosim[robot]" \
    && useradd --create-home --uid 1000 cosim
COPY --from=build --chown=cosim /fmus /home/cosim/fmus
USER 1000
WORKDIR /home/cosim
ENTRYPOINT ["cosim"]
CMD ["run"]
