# The page of `eivor serve`, on the host's loopback address only; the terminal prints its address with a token:
#
#     docker build --tag eivor . && docker run --rm --init --network host eivor
#
# Any other command: docker run --rm --volume "$PWD:/logs" --workdir /logs eivor identify flight.ulg
FROM python:3.13-slim AS build
WORKDIR /source
COPY pyproject.toml README.md LICENSE ./
COPY src src
RUN python -m venv /eivor && /eivor/bin/pip install --no-cache-dir ".[hdf5,ros,serve]"

FROM python:3.13-slim
COPY --from=build /eivor /eivor
RUN useradd --create-home --uid 1000 pilot
USER 1000
WORKDIR /home/pilot
ENTRYPOINT ["/eivor/bin/eivor"]
CMD ["serve", "--no-browser", "--port", "8765"]
