// A shape in react-three-fiber: copy this file. It needs three, @react-three/fiber and cndhf.
//
//   <Canvas camera={{ position: [0, 0, 120] }}>
//     <ambientLight /> <directionalLight position={[1, 2, 3]} />
//     <Suspense fallback={null}><Shape url="/bracket.cndhf" /></Suspense>
//   </Canvas>
import { useLoader } from "@react-three/fiber";
import { CNDHFLoader } from "cndhf/three";

interface ShapeProps {
  url: string;
  color?: string;
  /** Of surfaces: how often to subdivide. */
  level?: number;
}

export function Shape({ url, color = "#b8c4d0", level }: ShapeProps) {
  const geometry = useLoader(CNDHFLoader, url, (loader) => {
    if (level !== undefined) loader.setMeshOptions({ level });
  });
  return (
    <mesh geometry={geometry} position={geometry.userData.origin}>
      <meshStandardMaterial color={color} roughness={0.75} />
    </mesh>
  );
}
