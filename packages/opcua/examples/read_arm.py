"""Read a robot over OPC UA, and run a program with a password; see the page *OPC UA*.

urlink serve opcua arm=sim://ur5e
python read_arm.py arm
"""

import argparse
import asyncio
import math
import os

from asyncua import Client, ua
from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256

NAMESPACE = "urn:urlink:opcua"


async def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name", help="name of the robot")
    parser.add_argument("--url", default="opc.tcp://127.0.0.1:4840/urlink/")
    parser.add_argument("--certificate", help="certificate of this client; with it, the connection is encrypted")
    parser.add_argument("--private-key")
    parser.add_argument("--server-certificate", help="certificate that the server must have")
    parser.add_argument("--user", help="user name; the password is in URLINK_OPCUA_PASSWORD")
    parser.add_argument("--play", metavar="PROGRAM", help="load and start this program. The arm moves!")
    args = parser.parse_args()
    client = Client(args.url, timeout=30.0)
    client.session_timeout = 60_000
    if args.certificate:
        server = args.server_certificate
        await client.set_security(
            SecurityPolicyBasic256Sha256, args.certificate, args.private_key, server_certificate=server
        )
    if args.user:
        client.set_user(args.user)
        client.set_password(os.environ["URLINK_OPCUA_PASSWORD"])
    async with client:
        index = await client.get_namespace_index(NAMESPACE)

        async def read(name: str) -> object:
            return await client.get_node(ua.NodeId(f"{args.name}.{name}", index)).read_value()

        q = await read("JointPositions")
        assert isinstance(q, list)
        print(f"{args.name}: base at {math.degrees(q[0]):.2f} degrees, {await read('SafetyModeName')}")
        if args.play:
            arm = client.get_node(ua.NodeId(args.name, index))
            try:
                await arm.call_method(f"{index}:LoadProgram", args.play)
                await arm.call_method(f"{index}:PlayProgram")
            except ua.UaError as error:
                print(f"refused: {error}; {await read('LastCommand.Error')}")
            else:
                print(f"{args.play}: started")


if __name__ == "__main__":
    asyncio.run(main())
