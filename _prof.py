"""In-process processor time of one GET of a value: python s2_prof.py [profile]."""
import asyncio, sys, time, tempfile, json, cProfile, pstats, pathlib, dataclasses, gc
sys.path.insert(0, ".")
import logging
from service.app import create_app
from service.settings import Settings
from service.operations import logging as logs
import dsbrdf
from dsbrdf.data.synthetic import synthetic_measurement
from dsbrdf.data.merl import encode_merl
from dsbrdf.model import dsbrdf as _
async def main():
    with tempfile.TemporaryDirectory() as d:
        s = Settings(data_dir=pathlib.Path(d)/"data", workers=1)
        logs.configure(s)
        app = create_app(s)
        async with app.router.lifespan_context(app):
            async def ask(method, target, body=b"", headers=()):
                path, _, q = target.partition("?")
                scope = dict(type="http", asgi={"version":"3.0"}, http_version="1.1", method=method, path=path, raw_path=path.encode(), query_string=q.encode(), root_path="", scheme="http", server=("127.0.0.1",80), client=("127.0.0.1",5), headers=[(b"host", b"127.0.0.1:80"), (b"user-agent", b"wrk"), *headers], state={})
                sent = []
                msgs = [{"type":"http.request","body":body,"more_body":False}]
                async def receive():
                    if msgs: return msgs.pop()
                    await asyncio.sleep(1e9)
                async def send(m): sent.append(m)
                await app(scope, receive, send)
                return sent[0]["status"], b"".join(m.get("body", b"") for m in sent[1:])
            data = encode_merl(synthetic_measurement(noise=0.02, seed=1))
            st, b = await ask("POST", "/v1/fits?n_lobes=3", data, [(b"content-length", str(len(data)).encode()), (b"content-type", b"application/octet-stream")])
            assert st == 201, b
            fid = json.loads(b)["id"]
            t = f"/v1/fits/{fid}/brdf?theta_half_deg=10&theta_diff_deg=30"
            st, b = await ask("GET", t); assert st == 200, b
            async def run(n):
                gc.collect(); t0 = time.process_time()
                for _ in range(n): await ask("GET", t)
                return (time.process_time()-t0)/n*1e6
            await run(300)
            model = (await app.state.context.models.get(__import__("service.storage.schema",fromlist=["FitKey"]).FitKey("", fid))).model
            import numpy as np
            th, td, ph = np.radians([10.]), np.radians([30.]), np.radians([90.])
            def ev(n):
                t0=time.process_time()
                for _ in range(n): model.evaluate(th,td,ph)
                return (time.process_time()-t0)/n*1e6
            if "profile" in sys.argv:
                p = cProfile.Profile(time.thread_time); p.enable(); await run(1000); p.disable()
                pstats.Stats(p).sort_stats("cumtime").print_stats(75)
            else:
                g = sorted([await run(500) for _ in range(9)]); e = sorted([ev(500) for _ in range(9)])
                print(f"GET {g[0]:.0f} min {g[4]:.0f} median us; evaluate {e[0]:.0f} min {e[4]:.0f} median us")
                async def bad(n):
                    t0=time.process_time()
                    for _ in range(n): await ask("GET", "/v1/nothing")
                    return (time.process_time()-t0)/n*1e6
                b=sorted([await bad(300) for _ in range(5)]); print(f"404 {b[0]:.0f}")
asyncio.run(main())
