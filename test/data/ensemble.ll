define internal void @body(ptr %q, ptr %qd, ptr %tau, ptr %free, ptr %out) {
entry:
  %v1 = load <4 x double>, ptr %q, align 8
  %v2 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v1, <4 x double> splat (double 0x3FE45F306DC9C883), <4 x double> splat (double 0x4338000000000000))
  %v3 = fsub <4 x double> %v2, splat (double 0x4338000000000000)
  %v4 = getelementptr <4 x double>, ptr %q, i64 1
  %v5 = load <4 x double>, ptr %v4, align 8
  %v6 = fsub <4 x double> splat (double 0xC004000000000000), %v5
  %v7 = fneg <4 x double> %v3
  %v8 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v7, <4 x double> splat (double 0x3FF921FB54440000), <4 x double> %v1)
  %v9 = fneg <4 x double> %v5
  %v10 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v9, <4 x double> %v6, <4 x double> splat (double 0x3FF9000000000000))
  %v11 = fadd <4 x double> %v3, splat (double 0x3FF0000000000000)
  %v12 = fadd <4 x double> %v3, splat (double 0x4348000000000000)
  %v13 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v7, <4 x double> splat (double 0x3D868C234C4C0000), <4 x double> %v8)
  %v14 = fsub <4 x double> %v12, splat (double 0x4348000000000000)
  %v15 = fadd <4 x double> splat (double 0x4004000000000000), %v10
  %v16 = fsub <4 x double> %v13, %v8
  %v17 = fmul <4 x double> %v13, splat (double 0x3FE0000000000000)
  %v18 = fsub <4 x double> %v14, %v3
  %v19 = fmul <4 x double> %v17, %v13
  %v20 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v3, <4 x double> splat (double 0x3D868C234C4C0000), <4 x double> %v16)
  %v21 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v3, <4 x double> splat (double 0x3B298A2E03707345), <4 x double> %v20)
  %v22 = fneg <4 x double> %v19
  %v23 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v22, <4 x double> splat (double 0x3E45D8B559CDAE9C), <4 x double> splat (double 0x3EAAE5E4B83F3EFB))
  %v24 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v22, <4 x double> splat (double 0x3E18FA684A042C88), <4 x double> splat (double 0x3E81EE9DBCF1CA8B))
  %v25 = fdiv <4 x double> splat (double 0x3FF0000000000000), %v15
  %v26 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v23, <4 x double> %v19, <4 x double> splat (double 0xBF071DE35552B59E))
  %v27 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v24, <4 x double> %v19, <4 x double> splat (double 0xBEE27E4F7F19164F))
  %v28 = fmul <4 x double> %v13, %v19
  %v29 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v26, <4 x double> %v19, <4 x double> splat (double 0x3F5A01A019BE9217))
  %v30 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v27, <4 x double> %v19, <4 x double> splat (double 0x3F3A01A019C8F255))
  %v31 = fadd <4 x double> %v11, splat (double 0x4348000000000000)
  %v32 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v29, <4 x double> %v19, <4 x double> splat (double 0xBFA111111110F730))
  %v33 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v30, <4 x double> %v19, <4 x double> splat (double 0xBF86C16C16C15015))
  %v34 = fsub <4 x double> %v31, splat (double 0x4348000000000000)
  %v35 = fsub <4 x double> %v11, %v34
  %v36 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v32, <4 x double> %v19, <4 x double> splat (double 0x3FD5555555555548))
  %v37 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v28, <4 x double> %v36, <4 x double> %v21)
  %v38 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v33, <4 x double> %v19, <4 x double> splat (double 0x3FC555555555554B))
  %v39 = fsub <4 x double> %v13, %v37
  %v40 = fmul <4 x double> %v19, %v38
  %v41 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v22, <4 x double> %v40, <4 x double> %v19)
  %v42 = load <4 x double>, ptr %free, align 8
  %v43 = fcmp ogt <4 x double> %v42, splat (double 0x0000000000000000)
  %v44 = select <4 x i1> %v43, <4 x double> %v25, <4 x double> splat (double 0x0000000000000000)
  %v45 = fmul <4 x double> %v39, %v18
  %v46 = fmul <4 x double> %v39, %v35
  %v47 = fsub <4 x double> splat (double 0x3FF0000000000000), %v41
  %v48 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v47, <4 x double> %v35, <4 x double> %v45)
  %v49 = fneg <4 x double> %v47
  %v50 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v49, <4 x double> %v18, <4 x double> %v46)
  %v51 = load <4 x double>, ptr %qd, align 8
  %v52 = getelementptr <4 x double>, ptr %qd, i64 1
  %v53 = load <4 x double>, ptr %v52, align 8
  %v54 = fmul <4 x double> %v51, %v53
  %v55 = fmul <4 x double> %v51, %v51
  %v56 = fmul <4 x double> %v48, splat (double 0x4020000000000000)
  %v57 = getelementptr <4 x double>, ptr %free, i64 1
  %v58 = load <4 x double>, ptr %v57, align 8
  %v59 = fcmp ogt <4 x double> %v58, splat (double 0x0000000000000000)
  %v60 = select <4 x i1> %v59, <4 x double> splat (double 0x3FF0000000000000), <4 x double> splat (double 0x0000000000000000)
  %v61 = fmul <4 x double> %v55, %v5
  %v62 = fneg <4 x double> %v50
  %v63 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v62, <4 x double> splat (double 0x4020000000000000), <4 x double> %v61)
  %v64 = call <4 x double> @llvm.fma.v4f64(<4 x double> splat (double 0x4000000000000000), <4 x double> %v54, <4 x double> %v56)
  %v65 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v55, <4 x double> splat (double 0x3FF4000000000000), <4 x double> %v63)
  %v66 = fmul <4 x double> %v5, %v64
  %v67 = call <4 x double> @llvm.fma.v4f64(<4 x double> splat (double 0x3FF4000000000000), <4 x double> %v64, <4 x double> %v66)
  %v68 = getelementptr <4 x double>, ptr %tau, i64 1
  %v69 = load <4 x double>, ptr %v68, align 8
  %v70 = fadd <4 x double> %v69, %v65
  %v71 = fadd <4 x double> %v56, %v67
  %v72 = fmul <4 x double> %v70, %v60
  %v73 = load <4 x double>, ptr %tau, align 8
  %v74 = fsub <4 x double> %v73, %v71
  %v75 = fcmp ogt <4 x double> %v58, splat (double 0x0000000000000000)
  %v76 = select <4 x i1> %v75, <4 x double> %v72, <4 x double> splat (double 0x0000000000000000)
  %v77 = fmul <4 x double> %v74, %v44
  %v78 = fcmp ogt <4 x double> %v42, splat (double 0x0000000000000000)
  %v79 = select <4 x i1> %v78, <4 x double> %v77, <4 x double> splat (double 0x0000000000000000)
  store <4 x double> %v79, ptr %out, align 8
  %v80 = getelementptr <4 x double>, ptr %out, i64 1
  store <4 x double> %v76, ptr %v80, align 8
  ret void
}

define void @evaluate(ptr %q, ptr %qd, ptr %tau, ptr %free, ptr %out) {
entry:
  %a1 = alloca [2 x <4 x double>], align 64
  %v2 = load <4 x double>, ptr %q, align 8
  %v3 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v2, <4 x double> %v2, <4 x double> splat (double 0x0000000000000000))
  %v4 = fcmp ugt <4 x double> %v3, splat (double 0x4202A05F20000000)
  %v5 = call i1 @llvm.vector.reduce.or.v4i1(<4 x i1> %v4)
  br i1 %v5, label %then6, label %after7, !prof !0
then6:
  %v8 = load <4 x double>, ptr %q, align 8
  store <4 x double> %v8, ptr %a1, align 8
  call void @wrap_row(ptr %a1)
  %v9 = getelementptr <4 x double>, ptr %q, i64 1
  %v10 = load <4 x double>, ptr %v9, align 8
  %v11 = getelementptr <4 x double>, ptr %a1, i64 1
  store <4 x double> %v10, ptr %v11, align 8
  br label %after7
after7:
  %v12 = phi ptr [ %a1, %then6 ], [ %q, %entry ]
  call void @body(ptr %v12, ptr %qd, ptr %tau, ptr %free, ptr %out)
  ret void
}

define internal void @body_momentum(ptr %q, ptr %qd, ptr %qdd, ptr %out) {
entry:
  %v1 = load <4 x double>, ptr %qdd, align 8
  %v2 = getelementptr <4 x double>, ptr %q, i64 1
  %v3 = load <4 x double>, ptr %v2, align 8
  %v4 = fmul <4 x double> %v1, %v3
  %v5 = load <4 x double>, ptr %qd, align 8
  %v6 = getelementptr <4 x double>, ptr %qd, i64 1
  %v7 = load <4 x double>, ptr %v6, align 8
  %v8 = fmul <4 x double> %v5, %v7
  %v9 = call <4 x double> @llvm.fma.v4f64(<4 x double> splat (double 0x4000000000000000), <4 x double> %v8, <4 x double> %v4)
  %v10 = fmul <4 x double> splat (double 0x3FF9000000000000), %v1
  %v11 = fmul <4 x double> %v5, %v5
  %v12 = call <4 x double> @llvm.fma.v4f64(<4 x double> splat (double 0x3FF4000000000000), <4 x double> %v9, <4 x double> %v10)
  %v13 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v1, <4 x double> splat (double 0x3FF4000000000000), <4 x double> %v9)
  %v14 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v3, <4 x double> %v13, <4 x double> %v12)
  %v15 = fneg <4 x double> %v11
  %v16 = getelementptr <4 x double>, ptr %qdd, i64 1
  %v17 = load <4 x double>, ptr %v16, align 8
  %v18 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v15, <4 x double> %v3, <4 x double> %v17)
  %v19 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v15, <4 x double> splat (double 0x3FF4000000000000), <4 x double> %v18)
  %v20 = call <4 x double> @llvm.fma.v4f64(<4 x double> splat (double 0x4004000000000000), <4 x double> %v1, <4 x double> %v14)
  store <4 x double> %v20, ptr %out, align 8
  %v21 = getelementptr <4 x double>, ptr %out, i64 1
  store <4 x double> %v19, ptr %v21, align 8
  ret void
}

define internal void @body_inertial(ptr %q, ptr %qd, ptr %tau, ptr %free, ptr %out) {
entry:
  %v1 = getelementptr <4 x double>, ptr %q, i64 1
  %v2 = load <4 x double>, ptr %v1, align 8
  %v3 = fsub <4 x double> splat (double 0xC004000000000000), %v2
  %v4 = load <4 x double>, ptr %qd, align 8
  %v5 = fmul <4 x double> %v4, %v4
  %v6 = getelementptr <4 x double>, ptr %qd, i64 1
  %v7 = load <4 x double>, ptr %v6, align 8
  %v8 = fmul <4 x double> %v4, %v7
  %v9 = fneg <4 x double> %v2
  %v10 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v9, <4 x double> %v3, <4 x double> splat (double 0x3FF9000000000000))
  %v11 = fmul <4 x double> %v5, splat (double 0x3FF4000000000000)
  %v12 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v5, <4 x double> %v2, <4 x double> %v11)
  %v13 = fadd <4 x double> splat (double 0x4004000000000000), %v10
  %v14 = fmul <4 x double> splat (double 0x4000000000000000), %v8
  %v15 = fmul <4 x double> splat (double 0x4004000000000000), %v8
  %v16 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v2, <4 x double> %v14, <4 x double> %v15)
  %v17 = fdiv <4 x double> splat (double 0x3FF0000000000000), %v13
  %v18 = getelementptr <4 x double>, ptr %tau, i64 1
  %v19 = load <4 x double>, ptr %v18, align 8
  %v20 = fadd <4 x double> %v19, %v12
  %v21 = getelementptr <4 x double>, ptr %free, i64 1
  %v22 = load <4 x double>, ptr %v21, align 8
  %v23 = fcmp ogt <4 x double> %v22, splat (double 0x0000000000000000)
  %v24 = select <4 x i1> %v23, <4 x double> splat (double 0x3FF0000000000000), <4 x double> splat (double 0x0000000000000000)
  %v25 = fmul <4 x double> %v20, %v24
  %v26 = load <4 x double>, ptr %tau, align 8
  %v27 = fsub <4 x double> %v26, %v16
  %v28 = fcmp ogt <4 x double> %v22, splat (double 0x0000000000000000)
  %v29 = select <4 x i1> %v28, <4 x double> %v25, <4 x double> splat (double 0x0000000000000000)
  %v30 = load <4 x double>, ptr %free, align 8
  %v31 = fcmp ogt <4 x double> %v30, splat (double 0x0000000000000000)
  %v32 = select <4 x i1> %v31, <4 x double> %v17, <4 x double> splat (double 0x0000000000000000)
  %v33 = fmul <4 x double> %v27, %v32
  %v34 = fcmp ogt <4 x double> %v30, splat (double 0x0000000000000000)
  %v35 = select <4 x i1> %v34, <4 x double> %v33, <4 x double> splat (double 0x0000000000000000)
  store <4 x double> %v35, ptr %out, align 8
  %v36 = getelementptr <4 x double>, ptr %out, i64 1
  store <4 x double> %v29, ptr %v36, align 8
  ret void
}

define void @evaluate_momentum(ptr %q, ptr %qd, ptr %qdd, ptr %out) {
entry:
  %a1 = alloca [2 x <4 x double>], align 64
  %v2 = load <4 x double>, ptr %q, align 8
  %v3 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v2, <4 x double> %v2, <4 x double> splat (double 0x0000000000000000))
  %v4 = fcmp ugt <4 x double> %v3, splat (double 0x4202A05F20000000)
  %v5 = call i1 @llvm.vector.reduce.or.v4i1(<4 x i1> %v4)
  br i1 %v5, label %then6, label %after7, !prof !0
then6:
  %v8 = load <4 x double>, ptr %q, align 8
  store <4 x double> %v8, ptr %a1, align 8
  call void @wrap_row(ptr %a1)
  %v9 = getelementptr <4 x double>, ptr %q, i64 1
  %v10 = load <4 x double>, ptr %v9, align 8
  %v11 = getelementptr <4 x double>, ptr %a1, i64 1
  store <4 x double> %v10, ptr %v11, align 8
  br label %after7
after7:
  %v12 = phi ptr [ %a1, %then6 ], [ %q, %entry ]
  call void @body_momentum(ptr %v12, ptr %qd, ptr %qdd, ptr %out)
  ret void
}

define void @evaluate_inertial(ptr %q, ptr %qd, ptr %tau, ptr %free, ptr %out) {
entry:
  %a1 = alloca [2 x <4 x double>], align 64
  %v2 = load <4 x double>, ptr %q, align 8
  %v3 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v2, <4 x double> %v2, <4 x double> splat (double 0x0000000000000000))
  %v4 = fcmp ugt <4 x double> %v3, splat (double 0x4202A05F20000000)
  %v5 = call i1 @llvm.vector.reduce.or.v4i1(<4 x i1> %v4)
  br i1 %v5, label %then6, label %after7, !prof !0
then6:
  %v8 = load <4 x double>, ptr %q, align 8
  store <4 x double> %v8, ptr %a1, align 8
  call void @wrap_row(ptr %a1)
  %v9 = getelementptr <4 x double>, ptr %q, i64 1
  %v10 = load <4 x double>, ptr %v9, align 8
  %v11 = getelementptr <4 x double>, ptr %a1, i64 1
  store <4 x double> %v10, ptr %v11, align 8
  br label %after7
after7:
  %v12 = phi ptr [ %a1, %then6 ], [ %q, %entry ]
  call void @body_inertial(ptr %v12, ptr %qd, ptr %tau, ptr %free, ptr %out)
  ret void
}

define internal void @step(ptr %q, ptr %qd, ptr %qdd, ptr %tau, ptr %free) {
entry:
  %a1 = alloca [2 x <4 x double>], align 64
  %a2 = alloca [2 x <4 x double>], align 64
  %a3 = alloca [2 x <4 x double>], align 64
  %v4 = load <4 x double>, ptr %q, align 8
  %v5 = getelementptr <4 x double>, ptr %q, i64 1
  %v6 = load <4 x double>, ptr %v5, align 8
  %v7 = load <4 x double>, ptr %qd, align 8
  %v8 = getelementptr <4 x double>, ptr %qd, i64 1
  %v9 = load <4 x double>, ptr %v8, align 8
  %v10 = load <4 x double>, ptr %qdd, align 8
  %v11 = getelementptr <4 x double>, ptr %qdd, i64 1
  %v12 = load <4 x double>, ptr %v11, align 8
  %v13 = fmul <4 x double> splat (double 0x3F40000000000000), %v10
  %v14 = fmul <4 x double> splat (double 0x3F40000000000000), %v12
  %v15 = fadd <4 x double> %v7, %v13
  %v16 = fadd <4 x double> %v9, %v14
  %v17 = fmul <4 x double> splat (double 0x3F50000000000000), %v15
  %v18 = fmul <4 x double> splat (double 0x3F50000000000000), %v16
  %v19 = fadd <4 x double> %v4, %v17
  %v20 = fadd <4 x double> %v6, %v18
  %v21 = fmul <4 x double> splat (double 0x3F50000000000000), %v10
  %v22 = fmul <4 x double> splat (double 0x3F50000000000000), %v12
  %v23 = fadd <4 x double> %v7, %v21
  %v24 = fadd <4 x double> %v9, %v22
  store <4 x double> %v19, ptr %a1, align 8
  store <4 x double> %v23, ptr %a2, align 8
  %v25 = getelementptr <4 x double>, ptr %a1, i64 1
  store <4 x double> %v20, ptr %v25, align 8
  %v26 = getelementptr <4 x double>, ptr %a2, i64 1
  store <4 x double> %v24, ptr %v26, align 8
  call void @evaluate(ptr %a1, ptr %a2, ptr %tau, ptr %free, ptr %a3)
  %v27 = load <4 x double>, ptr %a3, align 8
  %v28 = getelementptr <4 x double>, ptr %a3, i64 1
  %v29 = load <4 x double>, ptr %v28, align 8
  %v30 = fadd <4 x double> %v10, %v27
  %v31 = fadd <4 x double> %v12, %v29
  %v32 = fmul <4 x double> splat (double 0x3F40000000000000), %v30
  %v33 = fmul <4 x double> splat (double 0x3F40000000000000), %v31
  %v34 = fadd <4 x double> %v7, %v32
  %v35 = fadd <4 x double> %v9, %v33
  store <4 x double> %v19, ptr %q, align 8
  %v36 = getelementptr <4 x double>, ptr %q, i64 1
  store <4 x double> %v20, ptr %v36, align 8
  store <4 x double> %v34, ptr %qd, align 8
  %v37 = getelementptr <4 x double>, ptr %qd, i64 1
  store <4 x double> %v35, ptr %v37, align 8
  store <4 x double> %v27, ptr %qdd, align 8
  %v38 = getelementptr <4 x double>, ptr %qdd, i64 1
  store <4 x double> %v29, ptr %v38, align 8
  ret void
}

define internal void @brake(ptr %q, ptr %qd, ptr %free) {
entry:
  %a17 = alloca [2 x <4 x double>], align 64
  %a18 = alloca [2 x <4 x double>], align 64
  %a19 = alloca [2 x <4 x double>], align 64
  %v1 = load <4 x double>, ptr %free, align 8
  %v2 = load <4 x double>, ptr %qd, align 8
  %v3 = fcmp ole <4 x double> %v1, splat (double 0x0000000000000000)
  %v4 = fcmp une <4 x double> %v2, splat (double 0x0000000000000000)
  %v5 = and <4 x i1> %v3, %v4
  %v6 = getelementptr <4 x double>, ptr %free, i64 1
  %v7 = load <4 x double>, ptr %v6, align 8
  %v8 = getelementptr <4 x double>, ptr %qd, i64 1
  %v9 = load <4 x double>, ptr %v8, align 8
  %v10 = fcmp ole <4 x double> %v7, splat (double 0x0000000000000000)
  %v11 = fcmp une <4 x double> %v9, splat (double 0x0000000000000000)
  %v12 = and <4 x i1> %v10, %v11
  %v13 = or <4 x i1> %v5, %v12
  %v14 = call i1 @llvm.vector.reduce.or.v4i1(<4 x i1> %v13)
  br i1 %v14, label %then15, label %after16, !prof !0
then15:
  store <4 x double> splat (double 0x0000000000000000), ptr %a17, align 8
  %v20 = getelementptr <4 x double>, ptr %a17, i64 1
  store <4 x double> splat (double 0x0000000000000000), ptr %v20, align 8
  call void @evaluate_momentum(ptr %q, ptr %a17, ptr %qd, ptr %a18)
  call void @evaluate_inertial(ptr %q, ptr %a17, ptr %a18, ptr %free, ptr %a19)
  %v21 = load <4 x double>, ptr %free, align 8
  %v22 = load <4 x double>, ptr %qd, align 8
  %v23 = load <4 x double>, ptr %a19, align 8
  %v24 = fcmp ogt <4 x double> %v21, splat (double 0x0000000000000000)
  %v25 = select <4 x i1> %v24, <4 x double> %v23, <4 x double> splat (double 0x0000000000000000)
  %v26 = select <4 x i1> %v13, <4 x double> %v25, <4 x double> %v22
  store <4 x double> %v26, ptr %qd, align 8
  %v27 = getelementptr <4 x double>, ptr %free, i64 1
  %v28 = load <4 x double>, ptr %v27, align 8
  %v29 = getelementptr <4 x double>, ptr %qd, i64 1
  %v30 = load <4 x double>, ptr %v29, align 8
  %v31 = getelementptr <4 x double>, ptr %a19, i64 1
  %v32 = load <4 x double>, ptr %v31, align 8
  %v33 = fcmp ogt <4 x double> %v28, splat (double 0x0000000000000000)
  %v34 = select <4 x i1> %v33, <4 x double> %v32, <4 x double> splat (double 0x0000000000000000)
  %v35 = select <4 x i1> %v13, <4 x double> %v34, <4 x double> %v30
  %v36 = getelementptr <4 x double>, ptr %qd, i64 1
  store <4 x double> %v35, ptr %v36, align 8
  br label %after16
after16:
  ret void
}

define internal void @whole_state(ptr %tau, ptr %error, ptr %gain, i64 %arm, i64 %column, i64 %b, i64 %last) {
entry:
  %v1 = sub i64 %last, %b
  %v2 = insertelement <4 x i64> poison, i64 %v1, i64 0
  %v3 = shufflevector <4 x i64> %v2, <4 x i64> poison, <4 x i32> zeroinitializer
  %v4 = call <4 x i64> @llvm.umin.v4i64(<4 x i64> <i64 0, i64 1, i64 2, i64 3>, <4 x i64> %v3)
  %v5 = insertelement <4 x i64> poison, i64 %arm, i64 0
  %v6 = shufflevector <4 x i64> %v5, <4 x i64> poison, <4 x i32> zeroinitializer
  %v7 = mul <4 x i64> %v4, %v6
  %v8 = mul i64 %b, %arm
  %v9 = getelementptr i8, ptr %gain, i64 %v8
  br label %loop10
loop10:
  %v11 = phi i64 [ 0, %entry ], [ %v29, %done28 ]
  %v12 = phi ptr [ %v9, %entry ], [ %v25, %done28 ]
  %v13 = getelementptr <4 x double>, ptr %tau, i64 %v11
  %v14 = load <4 x double>, ptr %v13, align 8
  br label %loop15
loop15:
  %v16 = phi i64 [ 0, %loop10 ], [ %v26, %loop15 ]
  %v17 = phi ptr [ %v12, %loop10 ], [ %v25, %loop15 ]
  %v18 = phi <4 x double> [ %v14, %loop10 ], [ %v24, %loop15 ]
  %v19 = getelementptr i8, ptr %v17, <4 x i64> %v7
  %v20 = call <4 x double> @llvm.masked.gather.v4f64.v4p0(<4 x ptr> align 8 %v19, <4 x i1> splat (i1 true), <4 x double> poison)
  %v21 = getelementptr <4 x double>, ptr %error, i64 %v16
  %v22 = load <4 x double>, ptr %v21, align 8
  %v23 = fmul <4 x double> %v20, %v22
  %v24 = fadd <4 x double> %v18, %v23
  %v25 = getelementptr i8, ptr %v17, i64 %column
  %v26 = add i64 %v16, 1
  %v27 = icmp ult i64 %v26, 4
  br i1 %v27, label %loop15, label %done28
done28:
  store <4 x double> %v24, ptr %v13, align 8
  %v29 = add i64 %v11, 1
  %v30 = icmp ult i64 %v29, 2
  br i1 %v30, label %loop10, label %done31
done31:
  ret void
}

define internal void @arms(i64 %b, i64 %last, i64 %steps, ptr %substeps, i64 %every, i64 %law, ptr %table, ptr %finite_steps) {
entry:
  %a11 = alloca [2 x <4 x double>], align 64
  %a20 = alloca [2 x <4 x double>], align 64
  %a29 = alloca [2 x <4 x double>], align 64
  %a38 = alloca [2 x <4 x double>], align 64
  %a47 = alloca [6 x <4 x double>], align 64
  %a56 = alloca [2 x <4 x double>], align 64
  %a65 = alloca [2 x <4 x double>], align 64
  %a74 = alloca [2 x <4 x double>], align 64
  %a91 = alloca [2 x <4 x double>], align 64
  %a100 = alloca [2 x <4 x double>], align 64
  %a182 = alloca [4 x <4 x double>], align 64
  %a237 = alloca [4 x i64], align 64
  %v1 = add i64 %b, 3
  %v2 = icmp ule i64 %v1, %last
  %v3 = getelementptr i64, ptr %table, i64 0
  %v4 = getelementptr i64, ptr %table, i64 1
  %v5 = getelementptr i64, ptr %table, i64 2
  %v6 = getelementptr i64, ptr %table, i64 3
  %v7 = load ptr, ptr %v3
  %v8 = load i64, ptr %v4
  %v9 = load i64, ptr %v5
  %v10 = load i64, ptr %v6
  %v12 = getelementptr i64, ptr %table, i64 4
  %v13 = getelementptr i64, ptr %table, i64 5
  %v14 = getelementptr i64, ptr %table, i64 6
  %v15 = getelementptr i64, ptr %table, i64 7
  %v16 = load ptr, ptr %v12
  %v17 = load i64, ptr %v13
  %v18 = load i64, ptr %v14
  %v19 = load i64, ptr %v15
  %v21 = getelementptr i64, ptr %table, i64 8
  %v22 = getelementptr i64, ptr %table, i64 9
  %v23 = getelementptr i64, ptr %table, i64 10
  %v24 = getelementptr i64, ptr %table, i64 11
  %v25 = load ptr, ptr %v21
  %v26 = load i64, ptr %v22
  %v27 = load i64, ptr %v23
  %v28 = load i64, ptr %v24
  %v30 = getelementptr i64, ptr %table, i64 12
  %v31 = getelementptr i64, ptr %table, i64 13
  %v32 = getelementptr i64, ptr %table, i64 14
  %v33 = getelementptr i64, ptr %table, i64 15
  %v34 = load ptr, ptr %v30
  %v35 = load i64, ptr %v31
  %v36 = load i64, ptr %v32
  %v37 = load i64, ptr %v33
  %v39 = getelementptr i64, ptr %table, i64 16
  %v40 = getelementptr i64, ptr %table, i64 17
  %v41 = getelementptr i64, ptr %table, i64 18
  %v42 = getelementptr i64, ptr %table, i64 19
  %v43 = load ptr, ptr %v39
  %v44 = load i64, ptr %v40
  %v45 = load i64, ptr %v41
  %v46 = load i64, ptr %v42
  %v48 = getelementptr i64, ptr %table, i64 20
  %v49 = getelementptr i64, ptr %table, i64 21
  %v50 = getelementptr i64, ptr %table, i64 22
  %v51 = getelementptr i64, ptr %table, i64 23
  %v52 = load ptr, ptr %v48
  %v53 = load i64, ptr %v49
  %v54 = load i64, ptr %v50
  %v55 = load i64, ptr %v51
  %v57 = getelementptr i64, ptr %table, i64 24
  %v58 = getelementptr i64, ptr %table, i64 25
  %v59 = getelementptr i64, ptr %table, i64 26
  %v60 = getelementptr i64, ptr %table, i64 27
  %v61 = load ptr, ptr %v57
  %v62 = load i64, ptr %v58
  %v63 = load i64, ptr %v59
  %v64 = load i64, ptr %v60
  %v66 = getelementptr i64, ptr %table, i64 28
  %v67 = getelementptr i64, ptr %table, i64 29
  %v68 = getelementptr i64, ptr %table, i64 30
  %v69 = getelementptr i64, ptr %table, i64 31
  %v70 = load ptr, ptr %v66
  %v71 = load i64, ptr %v67
  %v72 = load i64, ptr %v68
  %v73 = load i64, ptr %v69
  %v75 = getelementptr i64, ptr %table, i64 32
  %v76 = getelementptr i64, ptr %table, i64 33
  %v77 = getelementptr i64, ptr %table, i64 34
  %v78 = getelementptr i64, ptr %table, i64 35
  %v79 = load ptr, ptr %v75
  %v80 = load i64, ptr %v76
  %v81 = load i64, ptr %v77
  %v82 = load i64, ptr %v78
  %v83 = getelementptr i64, ptr %table, i64 36
  %v84 = getelementptr i64, ptr %table, i64 37
  %v85 = getelementptr i64, ptr %table, i64 38
  %v86 = getelementptr i64, ptr %table, i64 39
  %v87 = load ptr, ptr %v83
  %v88 = load i64, ptr %v84
  %v89 = load i64, ptr %v85
  %v90 = load i64, ptr %v86
  %v92 = getelementptr i64, ptr %table, i64 40
  %v93 = getelementptr i64, ptr %table, i64 41
  %v94 = getelementptr i64, ptr %table, i64 42
  %v95 = getelementptr i64, ptr %table, i64 43
  %v96 = load ptr, ptr %v92
  %v97 = load i64, ptr %v93
  %v98 = load i64, ptr %v94
  %v99 = load i64, ptr %v95
  %v101 = getelementptr i64, ptr %table, i64 44
  %v102 = getelementptr i64, ptr %table, i64 45
  %v103 = getelementptr i64, ptr %table, i64 46
  %v104 = getelementptr i64, ptr %table, i64 47
  %v105 = load ptr, ptr %v101
  %v106 = load i64, ptr %v102
  %v107 = load i64, ptr %v103
  %v108 = load i64, ptr %v104
  %v109 = getelementptr i64, ptr %table, i64 48
  %v110 = getelementptr i64, ptr %table, i64 49
  %v111 = getelementptr i64, ptr %table, i64 50
  %v112 = getelementptr i64, ptr %table, i64 51
  %v113 = load ptr, ptr %v109
  %v114 = load i64, ptr %v110
  %v115 = load i64, ptr %v111
  %v116 = load i64, ptr %v112
  %v117 = getelementptr i64, ptr %table, i64 52
  %v118 = getelementptr i64, ptr %table, i64 53
  %v119 = getelementptr i64, ptr %table, i64 54
  %v120 = getelementptr i64, ptr %table, i64 55
  %v121 = load ptr, ptr %v117
  %v122 = load i64, ptr %v118
  %v123 = load i64, ptr %v119
  %v124 = load i64, ptr %v120
  call void @copy_in(i1 false, ptr %a11, ptr %v7, i64 %v8, i64 %v9, i64 %b, i64 %last, i1 %v2, i64 2)
  call void @copy_in(i1 false, ptr %a20, ptr %v16, i64 %v17, i64 %v18, i64 %b, i64 %last, i1 %v2, i64 2)
  call void @copy_in(i1 false, ptr %a56, ptr %v52, i64 %v53, i64 %v54, i64 %b, i64 %last, i1 %v2, i64 2)
  %v125 = icmp eq i64 %law, 1
  br i1 %v125, label %then126, label %after127
then126:
  call void @copy_in(i1 false, ptr %a65, ptr %v61, i64 %v62, i64 %v63, i64 %b, i64 %last, i1 %v2, i64 2)
  call void @copy_in(i1 false, ptr %a74, ptr %v70, i64 %v71, i64 %v72, i64 %b, i64 %last, i1 %v2, i64 2)
  br label %after127
after127:
  %v128 = sub i64 %steps, 1
  br label %loop129
loop129:
  %v130 = phi i64 [ 0, %after127 ], [ %v234, %after221 ]
  %v131 = phi i64 [ 0, %after127 ], [ %v231, %after221 ]
  %v132 = phi i64 [ 1, %after127 ], [ %v233, %after221 ]
  %v133 = phi <4 x i64> [ zeroinitializer, %after127 ], [ %v216, %after221 ]
  %v134 = mul i64 %v130, %v37
  %v135 = getelementptr i8, ptr %v34, i64 %v134
  call void @copy_in(i1 false, ptr %a38, ptr %v135, i64 %v35, i64 %v36, i64 %b, i64 %last, i1 %v2, i64 2)
  %v136 = icmp ne i64 %law, 0
  br i1 %v136, label %then137, label %after138
then137:
  %v139 = mul i64 %v130, %v90
  %v140 = getelementptr i8, ptr %v87, i64 %v139
  call void @copy_in(i1 false, ptr %a91, ptr %v140, i64 %v88, i64 %v89, i64 %b, i64 %last, i1 %v2, i64 2)
  %v141 = mul i64 %v130, %v99
  %v142 = getelementptr i8, ptr %v96, i64 %v141
  call void @copy_in(i1 false, ptr %a100, ptr %v142, i64 %v97, i64 %v98, i64 %b, i64 %last, i1 %v2, i64 2)
  %v143 = load <4 x double>, ptr %a11, align 8
  %v144 = load <4 x double>, ptr %a91, align 8
  %v145 = fsub <4 x double> %v144, %v143
  %v146 = getelementptr <4 x double>, ptr %a11, i64 1
  %v147 = load <4 x double>, ptr %v146, align 8
  %v148 = getelementptr <4 x double>, ptr %a91, i64 1
  %v149 = load <4 x double>, ptr %v148, align 8
  %v150 = fsub <4 x double> %v149, %v147
  %v151 = load <4 x double>, ptr %a20, align 8
  %v152 = load <4 x double>, ptr %a100, align 8
  %v153 = fsub <4 x double> %v152, %v151
  %v154 = getelementptr <4 x double>, ptr %a20, i64 1
  %v155 = load <4 x double>, ptr %v154, align 8
  %v156 = getelementptr <4 x double>, ptr %a100, i64 1
  %v157 = load <4 x double>, ptr %v156, align 8
  %v158 = fsub <4 x double> %v157, %v155
  br i1 %v125, label %then159, label %after160
then159:
  %v161 = load <4 x double>, ptr %a38, align 8
  %v162 = load <4 x double>, ptr %a65, align 8
  %v163 = load <4 x double>, ptr %a74, align 8
  %v164 = fmul <4 x double> %v162, %v145
  %v165 = fadd <4 x double> %v161, %v164
  %v166 = fmul <4 x double> %v163, %v153
  %v167 = fadd <4 x double> %v165, %v166
  store <4 x double> %v167, ptr %a38, align 8
  %v168 = getelementptr <4 x double>, ptr %a38, i64 1
  %v169 = load <4 x double>, ptr %v168, align 8
  %v170 = getelementptr <4 x double>, ptr %a65, i64 1
  %v171 = load <4 x double>, ptr %v170, align 8
  %v172 = getelementptr <4 x double>, ptr %a74, i64 1
  %v173 = load <4 x double>, ptr %v172, align 8
  %v174 = fmul <4 x double> %v171, %v150
  %v175 = fadd <4 x double> %v169, %v174
  %v176 = fmul <4 x double> %v173, %v158
  %v177 = fadd <4 x double> %v175, %v176
  %v178 = getelementptr <4 x double>, ptr %a38, i64 1
  store <4 x double> %v177, ptr %v178, align 8
  br label %after160
after160:
  %v179 = icmp eq i64 %law, 2
  br i1 %v179, label %then180, label %after181
then180:
  store <4 x double> %v145, ptr %a182, align 8
  %v183 = getelementptr <4 x double>, ptr %a182, i64 1
  store <4 x double> %v150, ptr %v183, align 8
  %v184 = getelementptr <4 x double>, ptr %a182, i64 2
  store <4 x double> %v153, ptr %v184, align 8
  %v185 = getelementptr <4 x double>, ptr %a182, i64 3
  store <4 x double> %v158, ptr %v185, align 8
  %v186 = mul i64 %v130, %v82
  %v187 = getelementptr i8, ptr %v79, i64 %v186
  call void @whole_state(ptr %a38, ptr %a182, ptr %v187, i64 %v80, i64 %v81, i64 %b, i64 %last)
  br label %after181
after181:
  br label %after138
after138:
  call void @brake(ptr %a11, ptr %a20, ptr %a56)
  call void @evaluate(ptr %a11, ptr %a20, ptr %a38, ptr %a56, ptr %a29)
  br label %loop188
loop188:
  %v189 = phi i64 [ 0, %after138 ], [ %v193, %loop188 ]
  call void @step(ptr %a11, ptr %a20, ptr %a29, ptr %a38, ptr %a56)
  %v190 = load atomic i64, ptr %substeps monotonic, align 8
  %v191 = add i64 %v189, 1
  %v192 = icmp ult i64 %v191, %v190
  %v193 = add i64 %v189, 1
  %v194 = icmp ult i64 %v193, 9223372036854775807
  %v195 = and i1 %v192, %v194
  br i1 %v195, label %loop188, label %done196
done196:
  %v197 = load <4 x double>, ptr %a11, align 8
  %v198 = getelementptr <4 x double>, ptr %a11, i64 1
  %v199 = load <4 x double>, ptr %v198, align 8
  %v200 = load <4 x double>, ptr %a20, align 8
  %v201 = getelementptr <4 x double>, ptr %a20, i64 1
  %v202 = load <4 x double>, ptr %v201, align 8
  %v203 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v197, <4 x double> splat (double 0x0000000000000000), <4 x double> splat (double 0x0000000000000000))
  %v204 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v199, <4 x double> splat (double 0x0000000000000000), <4 x double> splat (double 0x0000000000000000))
  %v205 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v200, <4 x double> splat (double 0x0000000000000000), <4 x double> splat (double 0x0000000000000000))
  %v206 = call <4 x double> @llvm.fma.v4f64(<4 x double> %v202, <4 x double> splat (double 0x0000000000000000), <4 x double> splat (double 0x0000000000000000))
  %v207 = fadd <4 x double> %v203, %v204
  %v208 = fadd <4 x double> %v205, %v206
  %v209 = fadd <4 x double> %v207, %v208
  %v210 = fcmp ord <4 x double> %v209, %v209
  %v211 = insertelement <4 x i64> poison, i64 %v130, i64 0
  %v212 = shufflevector <4 x i64> %v211, <4 x i64> poison, <4 x i32> zeroinitializer
  %v213 = icmp eq <4 x i64> %v133, %v212
  %v214 = and <4 x i1> %v213, %v210
  %v215 = zext <4 x i1> %v214 to <4 x i64>
  %v216 = add <4 x i64> %v133, %v215
  %v217 = icmp eq i64 %v132, %every
  %v218 = icmp eq i64 %v130, %v128
  %v219 = or i1 %v217, %v218
  br i1 %v219, label %then220, label %after221
then220:
  call void @evaluate(ptr %a11, ptr %a20, ptr %a38, ptr %a56, ptr %a29)
  br i1 %v217, label %then222, label %after223
then222:
  %v224 = mul i64 %v131, %v108
  %v225 = getelementptr i8, ptr %v105, i64 %v224
  call void @copy_out(i1 false, ptr %a11, ptr %v225, i64 %v106, i64 %v107, i64 %b, i64 %last, i1 %v2, i64 2)
  %v226 = mul i64 %v131, %v116
  %v227 = getelementptr i8, ptr %v113, i64 %v226
  call void @copy_out(i1 false, ptr %a20, ptr %v227, i64 %v114, i64 %v115, i64 %b, i64 %last, i1 %v2, i64 2)
  %v228 = mul i64 %v131, %v124
  %v229 = getelementptr i8, ptr %v121, i64 %v228
  call void @copy_out(i1 false, ptr %a29, ptr %v229, i64 %v122, i64 %v123, i64 %b, i64 %last, i1 %v2, i64 2)
  br label %after223
after223:
  br label %after221
after221:
  %v230 = zext i1 %v217 to i64
  %v231 = add i64 %v131, %v230
  %v232 = add i64 %v132, 1
  %v233 = select i1 %v217, i64 1, i64 %v232
  %v234 = add i64 %v130, 1
  %v235 = icmp ult i64 %v234, %steps
  br i1 %v235, label %loop129, label %done236
done236:
  call void @copy_out(i1 false, ptr %a11, ptr %v7, i64 %v8, i64 %v9, i64 %b, i64 %last, i1 %v2, i64 2)
  call void @copy_out(i1 false, ptr %a20, ptr %v16, i64 %v17, i64 %v18, i64 %b, i64 %last, i1 %v2, i64 2)
  call void @copy_out(i1 false, ptr %a29, ptr %v25, i64 %v26, i64 %v27, i64 %b, i64 %last, i1 %v2, i64 2)
  store <4 x i64> %v216, ptr %a237, align 8
  br label %loop238
loop238:
  %v239 = phi i64 [ 0, %done236 ], [ %v247, %after243 ]
  %v240 = add i64 %b, %v239
  %v241 = icmp ule i64 %v240, %last
  br i1 %v241, label %then242, label %after243
then242:
  %v244 = getelementptr i64, ptr %a237, i64 %v239
  %v245 = load i64, ptr %v244
  %v246 = getelementptr i64, ptr %finite_steps, i64 %v240
  store i64 %v245, ptr %v246
  br label %after243
after243:
  %v247 = add i64 %v239, 1
  %v248 = icmp ult i64 %v247, 4
  br i1 %v248, label %loop238, label %done249
done249:
  ret void
}

define void @ensemble(i64 %first, i64 %until, i64 %last, i64 %steps, ptr %substeps, i64 %every, i64 %law, ptr %table, ptr %finite_steps) {
entry:
  br label %loop1
loop1:
  %v2 = phi i64 [ %first, %entry ], [ %v3, %loop1 ]
  call void @arms(i64 %v2, i64 %last, i64 %steps, ptr %substeps, i64 %every, i64 %law, ptr %table, ptr %finite_steps)
  %v3 = add i64 %v2, 4
  %v4 = icmp ult i64 %v3, %until
  br i1 %v4, label %loop1, label %done5
done5:
  ret void
}
