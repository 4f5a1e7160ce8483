# docker build -t nrbench . && docker run --rm -v "$PWD/runs:/work/runs" nrbench run core
FROM python:3.12-slim
COPY . /src
RUN pip install --no-cache-dir /src && rm -rf /src
WORKDIR /work
ENTRYPOINT ["nrbench"]
